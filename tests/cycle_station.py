"""A controller that takes each reply at once, for tests of the cycle in virtual time."""

from importlib.resources import files
from typing import Any

from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import State
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, SensorTelegram, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.stamped_samples import DistanceSample, WrenchSample

PERIOD = 12_000_000
START = 9_000_000_000
XML = files("linemate.protocol").joinpath("data", "rsi_joints.xml").read_bytes()
CODEC = RsiCodec(parse_config(XML))
SPEED = 0.106
LEAD_S = 1.4
"""The unit passes the start position this long after the first telegram."""


class Station:
    """A controller that takes each reply at once, and sensors that are always fresh."""

    def __init__(self, parameters: Parameters, task: Task, **options: Any) -> None:
        """Begin at the task's rest."""
        self.parameters = parameters
        on_rail = parameters.controller.arm.linear_axis
        self.absolute = bool(options.pop("absolute", True))
        link = RsiLink(CODEC, absolute=self.absolute, on_rail=on_rail)
        self.cycle = Cycle(parameters, link, **options)
        self.cycle.listen(0)
        self.start = (*task.file.arm.rest_joints, 0.0)
        self.mount = task.file.conveyor.start_position
        self.axes = self.start
        self.held = self.start
        self.k = 0
        self.ipoc, self.step = 4_208_111_000, 12
        self.delay = 0
        self.offset_ns = 0
        self.free_force = (0.0, 0.0, 0.1)
        self.commands = [self.start]

    @property
    def stamp_ns(self) -> int:
        return START + self.k * PERIOD + self.offset_ns

    def telegram(self, **changed: Any) -> bytes:
        a, b, c, d, e, f, axis = self.axes
        made = RobotTelegram(
            ipoc=self.ipoc,
            joints=(a, b, c, d, e, f),
            external=(axis, 0.0, 0.0, 0.0, 0.0, 0.0),
            tcp=(0.0,) * 6,
            delay=self.delay,
            channels={"DiL": 0},
        )
        return CODEC.format_robot(replace(made, **changed))

    def feed(self) -> None:
        stamp_ns = self.stamp_ns - 3_000_000
        self.cycle.samples.distance.push(DistanceSample(stamp_ns, self.where(stamp_ns), 1.0))
        self.cycle.samples.wrench.push(
            WrenchSample(stamp_ns, self.free_force, (0.0, 0.0, self.k * 1e-6))
        )

    def where(self, stamp_ns: int) -> float:
        """What the distance sensor reads [m]."""
        return self.mount + SPEED * ((stamp_ns - START) * 1e-9 - LEAD_S)

    def exchange(self, *, lost: bool = False, feed: bool = True) -> SensorTelegram:
        """One cycle; a lost reply is counted and the robot holds."""
        if feed:
            self.feed()
        reply = self.cycle.on_telegram(self.telegram(), self.stamp_ns)
        assert reply is not None
        fields = CODEC.parse_sensor(reply)
        self.next()
        if lost:
            self.delay += 1
        else:
            self.take(fields)
        return fields

    def take(self, fields: SensorTelegram) -> None:
        assert fields.joints is not None
        assert fields.external is not None
        origin = self.start if self.absolute else self.axes
        offsets = (*fields.joints, fields.external[0])
        self.axes = tuple(o + d for o, d in zip(origin, offsets, strict=True))
        self.commands.append(self.axes)

    def next(self, cycles: int = 1) -> None:
        """Time goes on."""
        self.k += cycles
        self.ipoc += cycles * self.step

    def run(self, cycles: int) -> None:
        for _ in range(cycles):
            self.exchange()

    def track(self, cycles: int = 0) -> "Station":
        """Get the task going: healthy, armed, started."""
        self.run(90)
        assert self.cycle.order("arm") is None
        self.run(2)
        assert self.cycle.order("start") is None
        self.run(2 + cycles)
        assert self.cycle.machine.state is State.TRACK
        return self


def bare(station: Station) -> bool:
    """One cycle; whether its reply has no corrections."""
    reply = station.cycle.on_telegram(station.telegram(), station.stamp_ns)
    is_bare = reply == b'<Sen Type="ImFree"><IPOC>%d</IPOC></Sen>' % station.ipoc
    station.next()
    return is_bare


def zero(fields: SensorTelegram) -> bool:
    assert fields.joints is not None
    assert fields.external is not None
    return not any((*fields.joints, *fields.external)) and fields.channels["DiO"] == 0
