"""Configuration of a station of emulated devices.

Invariants:
    Values only; the daemon has its own configuration of the same station.
"""

from dataclasses import dataclass, field
from pathlib import Path

from linemate import protocol
from linemate.protocol.sensors.distance import SHIPPED_DBC
from linemate.simulators.devices.egm.egm_controller import EgmConfig
from linemate.simulators.devices.fanuc.fanuc_controller import FanucConfig
from linemate.simulators.devices.line.cars import LinePlan
from linemate.simulators.devices.links.endpoint import Address
from linemate.simulators.devices.rsi_controller import ControllerConfig
from linemate.simulators.devices.worlds import OWN
from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell
from linemate.simulators.plants.scenario import Scenario

SHIPPED_RSI = Path(next(iter(protocol.__path__))) / "data" / "rsi_joints.xml"
"""RSI_EthernetConfig.xml: {RIst, AIPos, EIPos, Delay} and the tool's signals."""


@dataclass(frozen=True, slots=True)
class EmulatorConfig:
    """A station of emulated devices.

    Attributes:
        scenario: the world and its sensors.
        world: what solves it: "own" or "mujoco".
        mujoco: sizes of the MuJoCo station.
        line: cars that come one after the other; the scenario has what they have in common. No
            truth is kept of them. None: the one car of the scenario.
        controller: how a controller with RSI is set up; its cycle is the scenario's.
        egm: how a controller with ABB's EGM is set up instead, None for RSI.
        fanuc: how a controller with FANUC's Stream Motion is set up instead, None for RSI.
        rsi_xml: path of the site's RSI_EthernetConfig.xml.
        robot_target: where telegrams go; None: to IP_NUMBER and PORT of the configuration, with EGM
            to port 6510 of this host.
        robot_bind: where the controller sends from, port 0 for any.
        camera_target: address and port that poses are sent to.
        camera_source: camera id in each pose.
        camera_frame: frame the poses are given in.
        camera_object: object they are of.
        camera_clock_offset_s: the camera's clock minus this host's monotonic one [s].
        can_link: symbolic link to make for the slcan pty, None for none.
        can_bind: TCP port of the slcan adapter instead of the pty, None for the pty.
        dbc: describes the distance sensor's message.
        dbc_message: name of the message in the DBC.
        dbc_signal: the distance in it.
        distance_mount: what the sensor reads when the conveyor unit is at s = 0 [m].
        serial_link: symbolic link to make for the force-torque pty, None for none.
        serial_bind: TCP port of the force-torque sensor instead of the pty, None for the pty.
        force_torque_device: protocol of the sensor, "bota" or "robotiq-ft300".
        wait_answered: the world stands still until so many telegrams were answered, a missed one
            taking back an eighth of them. Nothing is charged before the first.
        end_after_release_s: end so long after the tool let go of the part [s]; None: do not.
        end_after_collision_s: end so long after a collision [s]; None: do not.
        state_period_s: period of the state reports [s].
        truth: file that takes the truth at the end, None for none.
    """

    scenario: Scenario = field(default_factory=Scenario)
    world: str = OWN
    mujoco: MujocoCell = field(default_factory=MujocoCell)
    line: LinePlan | None = None
    controller: ControllerConfig = field(default_factory=ControllerConfig)
    egm: EgmConfig | None = None
    fanuc: FanucConfig | None = None
    rsi_xml: Path = SHIPPED_RSI
    robot_target: Address | None = None
    robot_bind: Address = ("127.0.0.1", 0)
    camera_target: Address = ("127.0.0.1", 49200)
    camera_source: str = "camera"
    camera_frame: str = "camera"
    camera_object: str = "hub"
    camera_clock_offset_s: float = 86_400.0
    can_link: Path | None = None
    can_bind: Address | None = None
    dbc: Path = SHIPPED_DBC
    dbc_message: str = "CIA406_TPDO1"
    dbc_signal: str = "Position"
    distance_mount: float = 0.0
    serial_link: Path | None = None
    serial_bind: Address | None = None
    force_torque_device: str = "bota"
    wait_answered: int = 0
    end_after_release_s: float | None = None
    end_after_collision_s: float | None = None
    state_period_s: float = 0.1
    truth: Path | None = None
