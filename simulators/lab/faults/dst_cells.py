"""The cells of the fault campaign: the daemon's files, and the devices that belong to them.

A cell is a configuration file of the daemon, its task, and what the emulated devices are.
"""

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path

from linemate.daemon.config import config
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.settings import ControllerKind
from linemate.daemon.core.control.settings import AxisLimits
from linemate.daemon.core.parameters import Parameters
from linemate.simulators import harness
from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit
from linemate.simulators.devices.robot_plant import seven
from linemate.simulators.harness.cell import families
from linemate.simulators.harness.lockstep import parameters
from linemate.simulators.lab.faults.dst_plan import OTHER_LINE, CycleMs, FaultPlan
from linemate.simulators.plants.conveyor_plan import Conveyor, StopSignal
from linemate.simulators.plants.scenario import (
    Body,
    Contact,
    DistanceSensor,
    ForceTorque,
    Robot,
    Scenario,
    Swing,
    Vector7,
)

TASKS = Path(harness.__path__[0]) / "data" / "tasks"
LEAD_IN_S = 2.6
"""The camera sees the object so long before the start: the last gate needs checked predictions."""
MOUNT_M = 1.0
"""Reading of the distance sensor with the object at its place in the plant. The task's clock starts
before, so that the tool touches at about 1.1 s of scenario time [m]."""
SCREWS_S = 0.2
"""The screws are quicker than the shipped tool's, its clamp is not [s]."""


@dataclass(frozen=True, slots=True)
class FaultCell:
    """What is at hand.

    Attributes:
        force_torque: the device, None for none.
        message, signal: of the distance sensor.
        distance: the sensor behind it.
        wrench_period_s: of the force-torque sensor [s].
        stop_bit: of the robot controller's inputs, on which the line announces its stops.
    """

    file: str
    force_torque: str | None = "bota"
    message: str = "CIA406_TPDO1"
    signal: str = "Position"
    distance: DistanceSensor = field(default_factory=DistanceSensor)
    wrench_period_s: float = ForceTorque().period_s
    stop_bit: int | None = None


SHIPPED = ""
CELLS: dict[str, FaultCell] = {
    SHIPPED: FaultCell("dst_daemon.yaml"),
    "second-layout": FaultCell("dst_second_layout.yaml"),
    "six-axes": FaultCell("dst_six_axes.yaml"),
    "ft300": FaultCell("dst_ft300.yaml", force_torque="robotiq-ft300", wrench_period_s=0.01),
    "tf03": FaultCell(
        "dst_tf03.yaml",
        message="TF03",
        signal="Distance",
        distance=DistanceSensor(period_s=0.01, sigma=2e-3, quantisation=0.0),
        stop_bit=4,
    ),
    "no-force": FaultCell("dst_no_force.yaml", force_torque=None),
    OTHER_LINE: FaultCell("dst_daemon.yaml"),
    "fanuc": FaultCell("dst_fanuc.yaml"),
    "egm": FaultCell("dst_egm.yaml"),
}
"""By the name that a plan has."""


@cache
def station(cell: str = SHIPPED) -> LoadedConfig:
    """Return a cell's configuration of the daemon."""
    return config.load(TASKS / CELLS[cell].file)


@cache
def station_of(lead_ms: float, cycle_ms: CycleMs, cell: str = SHIPPED) -> LoadedConfig:
    """Return the same with how early replies are prepared and the controller's cycle [ms]."""
    plain = station(cell)
    config = replace(plain.config, realtime=replace(plain.config.realtime, lead_ms=lead_ms))
    match config.controller.kind:
        case ControllerKind.FANUC:
            changed = replace(config, fanuc=replace(config.fanuc, cycle_ms=cycle_ms))
        case ControllerKind.EGM:
            changed = replace(config, egm=replace(config.egm, cycle_ms=cycle_ms))
        case _:
            changed = replace(config, rsi=replace(config.rsi, cycle_ms=cycle_ms))
    return replace(plain, config=changed)


@cache
def compiled(cycle_s: float, cell: str = SHIPPED) -> Parameters:
    """Return the daemon's parameters, compiled once a process."""
    task, settings = station(cell).task, station(cell).config
    return parameters(task.file, task.urdf, settings.tracking, settings.control, cycle_s)


def axis_limits(cell: str = SHIPPED) -> tuple[AxisLimit, ...]:
    """Return the daemon's own limits for the judge: what is configured must hold exactly."""
    limits = tuple(map(_same, station(cell).config.control.limits))
    return (*limits, *LIMITS[len(limits) :])


def _same(limit: AxisLimits) -> AxisLimit:
    return AxisLimit(limit.lower, limit.upper, limit.speed, limit.acceleration, limit.jerk)


def rest_pose(cell: str = SHIPPED) -> Vector7:
    """Return where the task begins, A1..A6 [rad], E1 [m]."""
    return seven((*station(cell).task.file.arm.rest_joints, 0.0))


def scenario_of(plan: FaultPlan) -> Scenario:
    """Return the plant's truth: a body nearly where it should be, and the shipped clamp."""
    cell = CELLS[plan.cell]
    scenario = Scenario(
        name="dst",
        seed=plan.seed,
        cycle_s=plan.real_cycle_s,
        lead_in_s=LEAD_IN_S,
        duration_s=plan.duration_s + 1.0,
        conveyor=Conveyor(events=plan.events, stop_signal=StopSignal(bit=cell.stop_bit)),
        body=Body(offset_range=(0.01, 0.01, 0.01), tilt=0.05, swings=(Swing(amplitude_max=3e-3),)),
        distance=cell.distance,
        force_torque=ForceTorque(period_s=cell.wrench_period_s),
        robot=Robot(start=rest_pose(plan.cell)),
        contact=Contact(nutrunner_s=SCREWS_S),
        faults=plan.faults,
    )
    return families.truth(station(plan.cell).config.controller.kind.value, scenario)
