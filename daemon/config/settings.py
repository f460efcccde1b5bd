"""What a configuration file can say: the links, the doors, the host, and the method's settings.

Law of this file: frozen values with their ranges and nothing computed; SI units unless a name
says otherwise. Paths are as written; ``config`` resolves them. A section that is left out is a
link or a door that is not opened.
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
Count = Annotated[int, Ge(1), Le(1_000_000)]
Constant = bool | int | float | str
Groups = Annotated[tuple[Text, ...], Len(0, 32)]
ExternalAxis = Literal["E1", "E2", "E3", "E4", "E5", "E6"]


class Corrections(StrEnum):
    """How the controller's correction objects read the reply."""

    ABSOLUTE = "absolute"
    RELATIVE = "relative"


@dataclass(frozen=True, slots=True)
class RsiSettings:
    """The robot controller's link.

    Attributes:
        config: the controller's own RSI_EthernetConfig.xml; a bare name may be a shipped one.
        bind: numeric address to listen on.
        port: None takes the file's, 0 any.
        cycle_ms: of the controller; KUKA has 12 and 4, the others are for measurements.
        corrections: ``absolute`` (AK(k) = q_c(k) - q_start) or ``relative``.
        linear_axes: external axes that are linear, the others turn.
        peer: the only address that is answered, None: whoever comes first.
        constants: value by TAG of each RECEIVE element that linemate does not know; it is written
            in every reply.
    """

    config: Text = "rsi_joints.xml"
    bind: Text = "127.0.0.1"
    port: Port | None = None
    cycle_ms: Literal[1, 2, 4, 12] = 12
    corrections: Corrections = Corrections.ABSOLUTE
    linear_axes: Annotated[tuple[ExternalAxis, ...], Len(0, 6)] = ("E1",)
    peer: Text | None = None
    constants: Annotated[dict[Text, Constant], Len(0, 64)] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class DistanceSettings:
    """The distance sensor's link.

    Attributes:
        can: handed to ``can.Bus`` unchanged: interface, channel and whatever it wants.
        dbc: a bare name may be a shipped one.
        message, signal: in the DBC.
        strength: signal of the signal strength, None: found by itself.
        can_id: instead of the DBC's.
        step_m: worth of one count instead of the DBC's [m].
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
        peer: the only sender that is heard, ``ADDRESS`` or ``ADDRESS:PORT``. None: the first one
            that sends good poses; another may take over while that one is silent for 5 s.
        frame, object, source: the only ones accepted, None for any.
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
        dialogue: hold the device's start-up dialogue; off for one that streams by itself.
    """

    url: Text
    device: Literal["bota", "robotiq-ft300"] = "bota"
    baudrate: Annotated[int, Ge(1200), Le(10_000_000)] | None = None
    dialogue: bool = True


@dataclass(frozen=True, slots=True)
class UdpSettings:
    """The command protocol's UDP port.

    Attributes:
        keys: file of the pre-shared keys, which others must not read. With systemd's
            LoadCredential give its name with ``credential:`` before it.
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
    """The doors for operators.

    Attributes:
        socket: path of the local socket, None for none. Root and the daemon's own user may
            operate by it.
        operate_groups: groups of this host, by name or number, whose members may operate by the
            local socket too. None: the group that the socket's file has.
        view_groups: groups whose members may view by the local socket. Others are refused.
        udp: the UDP port, None for none.
        budget: messages handled after each reply to the robot, at most.
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
        directory: where they are written; it must exist.
        at_start: record from the start of the daemon; else when ordered.
        queue: messages that may wait for the disk before any step is dropped.
        chunk_kib: size of a chunk of the file.
        flush_s: what a sudden end of the process may lose at most [s].
        rotate_mib: size at which the next file begins.
        rotate_min: age at which the next file begins [min].
        total_mib: of all recordings in the directory, the oldest go; None keeps them all.
        reserve_mib: left free on the disk: with less a recording ends.
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
    """What is asked of the host; each refusal is told and never fatal.

    Attributes:
        priority: of SCHED_FIFO, None leaves the scheduler alone.
        lock_memory: lock the pages in memory (mlockall).
        cpus: the only cores used, empty leaves them alone.
        timer_slack_ns: None leaves it alone.
        cpu_dma_latency_us: deepest sleep allowed to the cores, None leaves it alone.
        keep_awake: a process of the idle class on each core used, which never lets it sleep; for
            virtual machines, whose host takes its time to wake a core. It costs those cores' power.
        lead_ms: how long before its telegram a reply is prepared; 0: when the telegram comes;
            None: as long before as steps have lately needed.
        incidents: directory for the times of the last two seconds, written when a deadline is
            missed or a fault is entered; it must exist. None keeps them nowhere.
        freeze_collector: freeze and disable the garbage collector once ready.
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
class Config:
    """A configuration file, whole.

    Attributes:
        task: what is assembled; a bare name may be a shipped one.
        overlays: files of parameters laid over tracking, control and watch, in this order, such
            as ``linemate identify`` writes; what operators saved comes last.
        state: directory for what operators save; None takes the service manager's.
        learning: how far, how fast and on what evidence the servos are learned anew from each
            motion, to be taken while the robot stands; None leaves them as they are.
        version: of the file's layout.
    """

    task: Text
    overlays: Annotated[tuple[Text, ...], Len(0, 16)] = ()
    state: Text | None = None
    rsi: RsiSettings = RsiSettings()
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
    version: Annotated[int, Ge(1), Le(1)] = 1
