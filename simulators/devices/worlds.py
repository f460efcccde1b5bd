"""Worlds by name: the plants of this project, or MuJoCo."""

from importlib.util import find_spec

from linemate.simulators.devices.emulated_world import EmulatedWorld
from linemate.simulators.mujoco_world.mujoco_cell import DrivenRamp, MujocoCell, RunOrder
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.world import World

OWN, MUJOCO = "own", "mujoco"
WORLDS = (OWN, MUJOCO)

UNUSED = ("body", "camera", "distance", "force_torque", "effector", "contact")
"""Parts of a scenario that the MuJoCo world has sizes of its own for."""


def require(name: str) -> None:
    """Check that a world can be built here.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
    """
    if name == MUJOCO and find_spec("mujoco") is None:
        raise ModuleNotFoundError("no module named 'mujoco'", name="mujoco")


def build_world(name: str, scenario: Scenario, cell: MujocoCell | None = None) -> EmulatedWorld:
    """Return a world at the beginning of a run.

    Args:
        cell: sizes of the MuJoCo station, its own if None.

    Raises:
        ModuleNotFoundError: MuJoCo is not installed.
        ValueError: no such world.
    """
    if name == OWN:
        return World(scenario)
    if name != MUJOCO:
        raise ValueError(f"no world {name!r}; there are {', '.join(WORLDS)}")
    from linemate.simulators.mujoco_world.mujoco_world import MujocoWorld

    return MujocoWorld(cell or MujocoCell(), order_of(scenario))


def order_of(scenario: Scenario) -> RunOrder:
    """Return what a scenario asks of any world: conveyor, axes at the start, and times."""
    return RunOrder(
        seed=scenario.seed,
        cycle_s=scenario.cycle_s,
        lead_in_s=scenario.lead_in_s,
        duration_s=scenario.duration_s,
        start=scenario.robot.start,
        nominal_speed=scenario.conveyor.nominal_speed,
        ramps=tuple(
            DrivenRamp(event.onset_s, event.kind == "start", abs(event.acceleration))
            for event in scenario.events
        ),
        hub=scenario.body.nominal,
        cell_seed=scenario.cell_seed,
    )
