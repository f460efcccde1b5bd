"""The ready reply is the reply that the ordinary way returns."""

from importlib.resources import files

import pytest
from hypothesis import given
from hypothesis import strategies as st
from msgspec.structs import replace

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import LONGEST_JUMP, Cycle
from linemate.daemon.cycle.setpoint_reference import UNACCOUNTED_S
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.stamped_samples import DistanceSample

T = 12_000_000
START = 5_000_000_000
PEER = ("127.0.0.1", 50_000)
XML = files("linemate.protocol").joinpath("data", "rsi_joints.xml").read_bytes()


class Robot:
    """A robot that goes where the last reply says, and sends its telegrams to several cycles."""

    def __init__(self, task: Task) -> None:
        self.codec = RsiCodec(parse_config(XML))
        self.rest = task.file.arm.rest_joints
        self.offsets: tuple[float, ...] = (0.0,) * 6
        self.axis = 0.0
        self.k = 0

    @property
    def stamp_ns(self) -> int:
        return START + self.k * T

    def telegram(self, **changed: object) -> bytes:
        joints = tuple(a + b for a, b in zip(self.rest, self.offsets, strict=True))
        telegram = RobotTelegram(
            ipoc=1000 + 12 * self.k,
            joints=joints,  # type: ignore[arg-type]
            external=(self.axis, 0.0, 0.0, 0.0, 0.0, 0.0),
            tcp=(0.0,) * 6,
            delay=0,
            channels={"DiL": 0},
        )
        return self.codec.format_robot(replace(telegram, **changed))  # type: ignore[arg-type]

    def follow(self, reply: bytes) -> None:
        correction = self.codec.parse_sensor(reply)
        assert correction.joints is not None
        assert correction.external is not None
        self.offsets, self.axis = correction.joints, correction.external[0]
        self.k += 1


def distance(robot: Robot, cycle: Cycle, before_ns: int = 3_000_000) -> None:
    """The unit goes by at the nominal speed."""
    stamp_ns = robot.stamp_ns - before_ns
    cycle.samples.distance.push(DistanceSample(stamp_ns, 1.0 + 0.106e-9 * (stamp_ns - START)))


def ready_cycle(parameters: Parameters, robot: Robot, cycles: int = 5) -> Cycle:
    """A cycle that has answered some telegrams and has the next reply ready."""
    cycle = Cycle(parameters, RsiLink(RsiCodec(parse_config(XML)), on_rail=True))
    cycle.listen(0)
    for _ in range(cycles):
        distance(robot, cycle)
        reply = cycle.on_telegram(robot.telegram(), robot.stamp_ns, PEER)
        assert reply is not None
        robot.follow(reply)
    assert cycle.prepare(robot.stamp_ns)
    return cycle


def ready_reply(cycle: Cycle, data: bytes, peer: tuple[str, int], stamp_ns: int) -> bytes | None:
    """What the driver sends before the telegram goes the ordinary way."""
    ready = cycle.ready_reply
    if ready is None or ready.peer != peer or stamp_ns > ready.until_ns:
        return None
    return ready.data if ready.telegram.matches(data) else None


def test_for_the_same_inputs_prepared_and_in_line_give_the_same_bytes(
    parameters: Parameters, task: Task
) -> None:
    robot = Robot(task)
    link = RsiLink(RsiCodec(parse_config(XML)), on_rail=True)
    inline, prepared, driven = (Cycle(parameters, link) for _ in range(3))
    for cycle in (inline, prepared, driven):
        cycle.listen(0)
    for k in range(300):
        for cycle in (inline, prepared, driven):
            distance(robot, cycle)
        data = robot.telegram()
        ready = [cycle.prepare(robot.stamp_ns) for cycle in (prepared, driven)]
        assert ready == [k > 0] * 2
        early = ready_reply(driven, data, PEER, robot.stamp_ns)
        replies = [
            cycle.on_telegram(data, robot.stamp_ns, PEER) for cycle in (inline, prepared, driven)
        ]
        assert replies[0] is not None
        assert replies[0] == replies[1] == replies[2]
        assert early in {None, replies[0]}
        assert (early is not None) == (k > 2)  # the counter's step takes three telegrams to learn
        logs = [cycle.take_log() for cycle in (inline, prepared, driven)]
        assert [len(log) for log in logs] == [1, 1, 1]
        assert logs[0][0].inputs == logs[1][0].inputs == logs[2][0].inputs
        robot.follow(replies[0])
    assert (inline.prepared, inline.inline) == (0, 300)
    assert (prepared.prepared, prepared.inline) == (299, 1)


def test_a_sample_that_comes_after_the_step_was_made_is_the_next_steps(
    parameters: Parameters, task: Task
) -> None:
    robot = Robot(task)
    cycle = ready_cycle(parameters, robot)
    cycle.take_log()
    distance(robot, cycle, before_ns=100_000)
    for count in (0, 1):
        reply = cycle.on_telegram(robot.telegram(), robot.stamp_ns, PEER)
        assert reply is not None
        robot.follow(reply)
        assert [len(entry.inputs.distance) for entry in cycle.take_log()] == [count]


@pytest.mark.parametrize(
    "change",
    [
        "nothing ready",
        "another peer",
        "a gap",
        "the last one",
        "a jump",
        "the delay",
        "cut",
        "nan",
        "too late",
    ],
)
def test_an_unexpected_telegram_does_not_get_the_ready_reply(
    parameters: Parameters, task: Task, change: str
) -> None:
    robot = Robot(task)
    cycle = ready_cycle(parameters, robot)
    data, peer, stamp_ns = robot.telegram(), PEER, robot.stamp_ns
    assert ready_reply(cycle, data, peer, stamp_ns) is not None
    if change == "nothing ready":
        cycle.on_missing(robot.stamp_ns)
    elif change == "another peer":
        peer = ("127.0.0.1", 50_001)
    elif change == "a gap":
        data = robot.telegram(ipoc=1000 + 12 * (robot.k + 1), ipoc_text=b"")
    elif change == "the last one":
        data = robot.telegram(ipoc=1000 + 12 * (robot.k - 1), ipoc_text=b"")
    elif change == "a jump":
        joints = list(robot.rest)
        joints[3] += 1.1 * LONGEST_JUMP
        data = robot.telegram(joints=tuple(joints))
    elif change == "the delay":
        data = robot.telegram(delay=1)
    elif change == "too late":
        stamp_ns += round(UNACCOUNTED_S * 1e9) - T
    elif change == "cut":
        data = data[:-3]
    else:
        data = data.replace(b'X="0.0', b'X="nan')
    assert ready_reply(cycle, data, peer, stamp_ns) is None


@given(st.data())
def test_the_ready_reply_is_what_the_ordinary_way_returns(
    parameters: Parameters, task: Task, data: st.DataObject
) -> None:
    robot = Robot(task)
    cycle = ready_cycle(parameters, robot, cycles=3)
    telegram = bytearray(robot.telegram())
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.integers(0, len(telegram) - 1))
        kind = data.draw(st.sampled_from(("flip", "drop", "put")))
        if kind == "flip":
            telegram[place] ^= 1 << data.draw(st.integers(0, 7))
        elif kind == "drop":
            del telegram[place]
        else:
            telegram.insert(place, data.draw(st.sampled_from(b"0159.-+eE\"'<>/ xA")))
    early = ready_reply(cycle, bytes(telegram), PEER, robot.stamp_ns)
    usual = cycle.on_telegram(bytes(telegram), robot.stamp_ns, PEER)
    assert early is None or early == usual
