"""Settings of a configuration file: links, command server, host, and the method.

Invariants:
- Frozen values with ranges; nothing is computed. SI units unless a name has another.
- Paths are as written. A section that is left out is a link or an endpoint that is not opened.
"""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any, Literal

from annotated_types import Ge, Gt, Le, Len

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.control.adaptation import AdaptationSettings
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.tracking.settings import TrackingSettings

Port = Annotated[int, Ge(0), Le(65535)]
Text = Annotated[str, Len(1, 4096)]
VariantName = Annotated[str, Len(1, 32)]
Along = Annotated[float, Ge(-30.0), Le(30.0)]  # position on the conveyor [m]
Count = Annotated[int, Ge(1), Le(1_000_000)]
Cycle = Annotated[int, Ge(1), Le(24)]
Constant = bool | int | float | str
Groups = Annotated[tuple[Text, ...], Len(0, 32)]
EGM_PORT = 6510  # of the UdpUc device in ABB's examples
ExternalAxis = Literal["E1", "E2", "E3", "E4", "E5", "E6"]


class ControllerKind(StrEnum):
    """Family of the robot's controller."""

    RSI = "rsi"
    EGM = "egm"
    FANUC = "fanuc"


@dataclass(frozen=True, slots=True)
class ControllerSettings:
    """The robot's controller.

    Attributes:
        kind: family. The section of the same name has its settings: ``rsi`` for KUKA RSI, ``egm``
            for ABB's Externally Guided Motion, ``fanuc`` for FANUC Stream Motion.
    """

    kind: ControllerKind = ControllerKind.RSI


class Corrections(StrEnum):
    """How the controller's correction objects read the reply."""

    ABSOLUTE = "absolute"
    RELATIVE = "relative"


@dataclass(frozen=True, slots=True)
class RsiSettings:
    """The link to a KUKA controller with RSI.

    Attributes:
        config: the controller's own RSI_EthernetConfig.xml; a bare name may be a shipped one.
        bind: numeric address to listen on.
        port: None takes the port of the controller's file, 0 any free port.
        cycle_ms: period of the controller [ms]. KUKA has 12 and 4.
        corrections: ``absolute`` (AK(k) = q_c(k) - q_start) or ``relative``.
        linear_axes: external axes that are linear; the others rotate.
        peer: the only address that is answered. None: any address.
        constants: value by TAG of each RECEIVE element that linemate does not know, for every
            reply.
    """

    config: Text = "rsi_joints.xml"
    bind: Text = "127.0.0.1"
    port: Port | None = None
    cycle_ms: Cycle = 12
    corrections: Corrections = Corrections.ABSOLUTE
    linear_axes: Annotated[tuple[ExternalAxis, ...], Len(0, 6)] = ("E1",)
    peer: Text | None = None
    constants: Annotated[dict[Text, Constant], Len(0, 64)] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class EgmSettings:
    """The link to an ABB controller with Externally Guided Motion.

    Attributes:
        bind: numeric address to listen on.
        port: UDP port that the controller sends to (UdpUc device of EGMSetupUC); 0 any free port.
        cycle_ms: period of the controller, SampleRate of EGMActJoint [ms]. ABB has multiples of
            4.
        robotware: generation of the controller; a message of the other one is refused.
        signals: the tool's signals are the first number of RAPIDtoRobot and RAPIDfromRobot, which
            RobotWare 7 has.
        linear_axes: external axes that are linear; the others rotate.
        peer: the only address that is answered. None: any address.
    """

    bind: Text = "127.0.0.1"
    port: Port = EGM_PORT
    cycle_ms: Cycle = 4
    robotware: Literal[6, 7] = 7
    signals: bool = True
    linear_axes: Annotated[tuple[ExternalAxis, ...], Len(0, 6)] = ("E1",)
    peer: Text | None = None


@dataclass(frozen=True, slots=True)
class FanucSettings:
    """The link to a FANUC controller with Stream Motion (J519).

    Attributes:
        peer: numeric address of the controller, which the daemon asks for its packets.
        peer_port: UDP port of the controller.
        bind: numeric address of this host's interface to the controller.
        port: UDP port of this host; 0 takes any free one.
        version: of the protocol that the controller speaks.
        cycle_ms: period of the controller [ms]: 8 on an R-30iB.
        coupled: the controller's J3 is relative to the horizontal: q3 = J3 + J2. False if it is
            relative to J2, as in the URDF.
        rail: J7 is the linear axis that the task's arm stands on.
        signals_byte: place of the tool's signals in the controller's inputs and outputs, 0..255.
            None: the task has times instead of signals.
    """

    peer: Text | None = None
    peer_port: Annotated[int, Ge(1), Le(65535)] = 60015
    bind: Text = "127.0.0.1"
    port: Port = 0
    version: Literal[3, 4] = 3
    cycle_ms: Cycle = 8
    coupled: bool = False
    rail: bool = False
    signals_byte: Annotated[int, Ge(0), Le(255)] | None = None


@dataclass(frozen=True, slots=True)
class DistanceSettings:
    """The distance sensor's link.

    Attributes:
        can: arguments of ``can.Bus``: interface, channel and others.
        dbc: a bare name may be a shipped one.
        message, signal: names in the DBC, as it writes them.
        strength: signal of the signal strength. None searches the DBC for it.
        can_id: instead of the DBC's.
        step_m: size of one count instead of the DBC's [m]. A DBC with a negative factor is for a
            sensor that counts down as the conveyor runs.
    """

    can: dict[str, Any]
    dbc: Text = "distance.dbc"
    message: Text = "CIA406_TPDO1"
    signal: Text = "Position"
    strength: Text | None = None
    can_id: Annotated[int, Ge(0), Le(0x1FFFFFFF)] | None = None
    step_m: Annotated[float, Ge(1e-7), Le(0.02)] | None = None


@dataclass(frozen=True, slots=True)
class CameraSettings:
    """The camera's link.

    Attributes:
        bind: numeric address to listen on.
        port: UDP port; 0 takes any free one.
        peer: the only sender that is accepted, ``ADDRESS`` or ``ADDRESS:PORT``. None: the first
            one that sends good poses. Another may replace it after 5 s of silence.
        frame, object, source: the only ones accepted, None for any. Of several objects in view the
            first one counts until it has not been seen for 1 s.
    """

    bind: Text = "127.0.0.1"
    port: Port = 49153
    peer: Text | None = None
    frame: Text | None = "camera"
    object: Text | None = "hub"
    source: Text | None = None


@dataclass(frozen=True, slots=True)
class ForceTorqueSettings:
    """The force-torque sensor's link.

    Attributes:
        url: a tty, a pty or ``socket://host:port``.
        device: whose stream it is.
        baudrate: None takes the device's.
        dialogue: start the device's stream by its commands. Off for a device that streams at once.
    """

    url: Text
    device: Literal["bota", "robotiq-ft300"] = "bota"
    baudrate: Annotated[int, Ge(1200), Le(10_000_000)] | None = None
    dialogue: bool = True


@dataclass(frozen=True, slots=True)
class UdpSettings:
    """The command protocol's UDP port.

    Attributes:
        keys: file of the pre-shared keys, which others must not read. ``credential:NAME`` is a
            file of systemd's LoadCredential.
        bind: numeric address of the interface.
        port: UDP port; 0 takes any free one.
        allow_remote: explicit consent to an address that others can reach.
    """

    keys: Text
    bind: Text = "127.0.0.1"
    port: Port = 49160
    allow_remote: bool = False


@dataclass(frozen=True, slots=True)
class CommandSettings:
    """The endpoints for operators.

    Attributes:
        socket: path of the Unix socket, None for none. Root and the daemon's own user may
            operate.
        operate_groups: groups of this host, by name or number, whose members may operate too.
            None: the group of the socket's file.
        view_groups: groups whose members may view. All other users are refused.
        udp: the UDP port, None for none.
        budget: most messages handled after each reply to the robot.
    """

    socket: Text | None = None
    operate_groups: Groups | None = None
    view_groups: Groups = ()
    udp: UdpSettings | None = None
    budget: Annotated[int, Ge(1), Le(64)] = 8


@dataclass(frozen=True, slots=True)
class RecordingSettings:
    """Recordings.

    Attributes:
        directory: directory of the files. It must exist.
        at_start: record from the start of the daemon, else on ``linemate record start``.
        queue: most messages that wait for the disk before steps are dropped.
        chunk_kib: size of a chunk of the file.
        flush_s: most that a sudden end of the process loses [s].
        rotate_mib: size at which the next file begins.
        rotate_min: age at which the next file begins [min].
        total_mib: limit for all recordings in the directory. The oldest are removed. None keeps
            them all.
        reserve_mib: free space on the disk below which a recording ends.
    """

    directory: Text
    at_start: bool = False
    queue: Count = 4096
    chunk_kib: Annotated[int, Ge(1), Le(4096)] = 64
    flush_s: Annotated[float, Gt(0.0), Le(10.0)] = 0.5
    rotate_mib: Annotated[int, Ge(1), Le(65_536)] = 512
    rotate_min: Annotated[float, Ge(0.01), Le(10_080.0)] = 60.0
    total_mib: Annotated[int, Ge(1), Le(100_000_000)] | None = None
    reserve_mib: Annotated[int, Ge(0), Le(1_000_000)] = 64


@dataclass(frozen=True, slots=True)
class RealtimeSettings:
    """Requests to the host. Each refusal is a warning in the log and the status.

    Attributes:
        priority: SCHED_FIFO priority. None keeps the scheduler as it is.
        lock_memory: lock the pages in memory (mlockall).
        cpus: the only cores used. Empty: all.
        timer_slack_ns: None leaves it alone.
        cpu_dma_latency_us: longest wake-up time of a sleeping core [us]. None keeps the host's.
        keep_awake: a process of the idle class spins on each core, so that it never sleeps. For
            virtual machines, whose host wakes a core late. It costs the power of those cores.
        lead_ms: time from preparing a reply to its telegram [ms]. 0: prepared when the telegram
            comes. None: as long as recent steps have needed.
        incidents: directory for the cycle times of the last two seconds, written after a missed
            deadline or a fault. It must exist. None writes none.
        freeze_collector: freeze and disable the garbage collector after the start.
    """

    priority: Annotated[int, Ge(1), Le(98)] | None = None
    lock_memory: bool = False
    cpus: Annotated[tuple[Annotated[int, Ge(0), Le(4095)], ...], Len(0, 1024)] = ()
    timer_slack_ns: Annotated[int, Ge(1), Le(1_000_000)] | None = None
    cpu_dma_latency_us: Annotated[int, Ge(0), Le(1_000_000)] | None = None
    keep_awake: bool = False
    lead_ms: Annotated[float, Ge(0.0), Le(5.0)] | None = None
    incidents: Text | None = None
    freeze_collector: bool = True


@dataclass(frozen=True, slots=True)
class TrackingWindow:
    """Where on the conveyor a part may be started and must be left.

    Positions are of the object relative to ``conveyor.start_position`` of its task [m]: 0 as the
    task's clock starts, negative before.

    Attributes:
        start: from here on the cell prepares for the part.
        latest_start: a part that is farther when the cell is ready is let go.
        abort: a part that is farther is left.
    """

    start: Along = -2.0
    latest_start: Along = -0.05
    abort: Along = 4.0


@dataclass(frozen=True, slots=True)
class ProductionSettings:
    """Car after car.

    Attributes:
        variants: task file by variant. A bare name may be a shipped one.
        window: where a part may be started and must be left.
        announced_at: position of a part as it is announced, relative to
            ``conveyor.start_position`` [m].
        records: directory of the quality records. It must exist. None keeps none.
        days: days whose records are kept.
        goes_home: the daemon brings the robot home after each part. Off for a robot program
            that drives home by itself.
        name: of the station, for the records.
    """

    variants: Annotated[dict[VariantName, Text], Len(1, 32)]
    window: TrackingWindow = TrackingWindow()
    announced_at: Along = -3.0
    records: Text | None = None
    days: Annotated[int, Ge(1), Le(3650)] = 90
    goes_home: bool = True
    name: Annotated[str, Len(1, 64)] = "station"


def window_error(window: TrackingWindow, announced_at: float) -> tuple[str, str] | None:
    """Return the key of a position that is out of order and the reason, None if all are in order.

    Args:
        announced_at: position of a part as it is announced [m].
    """
    if not announced_at <= window.latest_start:
        return "announced_at", f"{announced_at:g} m is beyond window.latest_start"
    if not window.start < window.latest_start:
        return "window.start", f"{window.start:g} m is not before window.latest_start"
    if not window.latest_start < window.abort:
        return "window.abort", f"{window.abort:g} m is not behind window.latest_start"
    return None


@dataclass(frozen=True, slots=True)
class Config:
    """A configuration file, whole.

    Attributes:
        task: task file; a bare name may be a shipped one.
        overlays: files of parameters for tracking, control and watch, in this order, such as
            ``linemate identify`` writes. What operators saved comes last.
        state: directory for what operators save, and for the digests of tasks whose rehearsal was
            good: the next start leaves it out. None takes StateDirectory= of the unit.
        learning: limits for the servo models that each motion estimates again, for use once the
            robot stands; not with production. None keeps the models.
        learn_touches: correct ``tracking.camera.felt``, ``felt_depth`` and ``felt_turn`` by where
            good assemblies felt the object.
        learn_distance: correct ``tracking.distance.late`` and ``scale`` by how the tool moved on
            with the object in good assemblies.
        learn_part_mass: correct ``tracking.payload.part_mass`` by what the tool weighs less after
            good assemblies.
        production: parts one after the other, by their variants. None: each task is armed and
            started by hand.
        version: of the file's layout.
    """

    task: Text
    overlays: Annotated[tuple[Text, ...], Len(0, 16)] = ()
    state: Text | None = None
    controller: ControllerSettings = ControllerSettings()
    rsi: RsiSettings = RsiSettings()
    egm: EgmSettings = EgmSettings()
    fanuc: FanucSettings = FanucSettings()
    distance: DistanceSettings | None = None
    camera: CameraSettings | None = None
    force_torque: ForceTorqueSettings | None = None
    command: CommandSettings = CommandSettings()
    recording: RecordingSettings | None = None
    realtime: RealtimeSettings = RealtimeSettings()
    watch: WatchSettings = field(default_factory=WatchSettings)
    tracking: TrackingSettings = field(default_factory=TrackingSettings)
    control: ControlSettings = field(default_factory=ControlSettings)
    learning: AdaptationSettings | None = None
    learn_touches: bool = False
    learn_distance: bool = False
    learn_part_mass: bool = False
    production: ProductionSettings | None = None
    version: Annotated[int, Ge(1), Le(1)] = 1
