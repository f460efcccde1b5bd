"""The strict controller, cycle by cycle, in no time at all."""

import math
from dataclasses import replace
from pathlib import Path

import pytest

from linemate import protocol
from linemate.protocol.exchange_controller import Judgement
from linemate.protocol.rsi.codec import RsiCodec, RsiConfig, SensorTelegram, parse_config
from linemate.simulators.devices.rsi_controller import (
    Applied,
    ControllerConfig,
    RobotReading,
    RsiController,
    Seven,
)

DATA = Path(next(iter(protocol.__path__))) / "data"
START: Seven = (0.0, -math.pi / 2, math.pi / 2, 0.0, math.pi / 2, 0.0, 0.5)
TCP = (1.0, 2.0, 3.0, 0.1, 0.2, 0.3)
NOTHING = (0.0,) * 6
DEG = math.radians(1.0)


def _rsi(name: str = "rsi_joints.xml") -> RsiConfig:
    return parse_config((DATA / name).read_bytes())


def _controller(
    config: ControllerConfig | None = None, rsi: RsiConfig | None = None
) -> RsiController:
    return RsiController(
        rsi or _rsi(), lambda: RobotReading(START, TCP, digital_in=1), START, config
    )


def _holdon(rsi: RsiConfig, *, holdon: bool) -> RsiConfig:
    return replace(rsi, receive=tuple(replace(e, holdon=holdon) for e in rsi.receive))


class Peer:
    """A daemon that answers with given corrections."""

    def __init__(self, controller: RsiController) -> None:
        self.controller = controller
        self.codec = RsiCodec(controller.codec.config)

    def reply(self, joints: tuple[float, ...], e1: float = 0.0, dio: int = 0) -> bytes:
        """Open a cycle; the reply to it, not yet sent."""
        data = self.controller.telegram()
        assert data is not None
        telegram = self.codec.parse_robot(data)
        a, b, c, d, e, f = joints
        return self.codec.format_sensor(
            SensorTelegram(
                telegram.ipoc,
                telegram.ipoc_text,
                joints=(a, b, c, d, e, f),
                external=(e1,),
                channels={"DiO": dio},
            )
        )

    def cycle(self, joints: tuple[float, ...] = NOTHING, e1: float = 0.0, dio: int = 0) -> Applied:
        """One whole cycle with a good reply."""
        data = self.reply(joints, e1, dio)
        assert self.controller.on_reply(data) is Judgement.ACCEPTED
        return self.controller.end_of_cycle()

    def silent_cycle(self) -> Applied:
        """One cycle without a reply."""
        assert self.controller.telegram() is not None
        return self.controller.end_of_cycle()


def _step(a1: float) -> tuple[float, ...]:
    return (a1, 0.0, 0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("name", ["rsi_joints.xml", "rsi_joints_setpoints.xml"])
def test_both_shipped_layouts_tell_the_robot_as_it_is(name: str) -> None:
    controller = _controller(rsi=_rsi(name))
    data = controller.telegram()
    assert data is not None
    telegram = controller.codec.parse_robot(data)
    assert telegram.joints == pytest.approx(START[:6], abs=1e-9)
    assert telegram.tcp == pytest.approx(TCP, abs=1e-9)
    assert telegram.delay == 0
    assert telegram.channels.get("DiL", 1) == 1
    if telegram.external is not None:
        assert telegram.external == pytest.approx((0.5, 0, 0, 0, 0, 0))


def test_programmed_setpoints_do_not_hold_the_corrections() -> None:
    controller = _controller(rsi=_rsi("rsi_joints_setpoints.xml"))
    Peer(controller).cycle(_step(DEG))
    data = controller.telegram()
    assert data is not None
    assert controller.codec.parse_robot(data).joint_setpoints == pytest.approx(START[:6])


def test_corrections_are_relative_to_the_start_pose() -> None:
    peer = Peer(_controller())
    applied = peer.cycle((0.01, -0.02, 0.03, 0.0, 0.0, -0.04), e1=0.002)
    moved = (0.01, -0.02, 0.03, 0.0, 0.0, -0.04, 0.002)
    assert applied.setpoints == pytest.approx(
        [a + b for a, b in zip(START, moved, strict=True)], abs=1e-9
    )
    assert applied.answered
    assert applied.cycle == 0


def test_relative_corrections_add_up() -> None:
    peer = Peer(_controller(ControllerConfig(mode="relative")))
    for _ in range(3):
        applied = peer.cycle(_step(0.001))
    assert applied.setpoints[0] == pytest.approx(0.003, abs=1e-9)


def test_the_tools_signals_ride_along() -> None:
    assert Peer(_controller()).cycle(dio=2).digital_out == 2


def test_the_counter_steps_by_the_cycles_milliseconds() -> None:
    peer = Peer(_controller(ControllerConfig(cycle_s=0.004, first_ipoc=100)))
    assert [peer.cycle().ipoc for _ in range(3)] == [100, 104, 108]


def test_a_wrong_counter_is_refused_and_reported_in_delay() -> None:
    controller = _controller()
    peer = Peer(controller)
    peer.cycle()
    ipoc = 4_208_163_634 + 12
    data = peer.reply(_step(DEG)).replace(b"%d" % ipoc, b"%d" % (ipoc + 1))
    assert controller.on_reply(data) is Judgement.WRONG_COUNTER
    applied = controller.end_of_cycle()
    assert not applied.answered
    assert applied.setpoints == START
    assert controller.counts.refused == 1
    following = controller.telegram()
    assert following is not None
    assert controller.codec.parse_robot(following).delay == 1


def test_another_sentype_is_as_no_answer() -> None:
    controller = _controller()
    data = Peer(controller).reply(NOTHING).replace(b"ImFree", b"ImFrei")
    assert controller.on_reply(data) is Judgement.REFUSED
    assert controller.refusals["sentype"] == 1
    assert controller.end_of_cycle().outcome is Judgement.REFUSED


@pytest.mark.parametrize("data", [b"", b"<Sen", b"\xff" * 100, b"<!DOCTYPE x>", b"x" * 5000])
def test_garbage_is_as_no_answer(data: bytes) -> None:
    controller = _controller()
    controller.telegram()
    assert controller.on_reply(data) is Judgement.REFUSED
    assert controller.end_of_cycle().setpoints == START
    assert controller.counts.refused == 1
    assert controller.delay == 1


def test_a_reply_at_the_deadline_is_late() -> None:
    controller = _controller()
    data = Peer(controller).reply(_step(DEG))
    assert controller.on_reply(data, stamp_ns=12, deadline_ns=12) is Judgement.LATE
    assert controller.end_of_cycle().setpoints == START
    assert (controller.counts.late, controller.counts.lost) == (1, 0)


def test_a_reply_in_the_next_cycle_is_late_and_not_lost() -> None:
    controller = _controller()
    peer = Peer(controller)
    data = peer.reply(_step(DEG))
    controller.end_of_cycle()
    assert controller.counts.lost == 1
    controller.telegram()
    assert controller.on_reply(data) is Judgement.LATE
    assert (controller.counts.late, controller.counts.lost) == (1, 0)


def test_a_missing_reply_holds_the_last_value() -> None:
    peer = Peer(_controller())
    moved = peer.cycle(_step(0.001), dio=1)
    held = peer.silent_cycle()
    assert held.setpoints == moved.setpoints
    assert held.digital_out == 1
    assert peer.controller.counts.lost == 1


def test_without_holdon_a_missing_reply_is_zero() -> None:
    peer = Peer(_controller(rsi=_holdon(_rsi(), holdon=False)))
    assert peer.cycle(_step(0.001), dio=1).setpoints[0] == pytest.approx(0.001)
    back = peer.silent_cycle()
    assert back.setpoints == START
    assert back.digital_out == 0


def test_held_increments_go_on_running() -> None:
    peer = Peer(_controller(ControllerConfig(mode="relative")))
    peer.cycle(_step(0.001))
    peer.silent_cycle()
    assert peer.silent_cycle().setpoints[0] == pytest.approx(0.003, abs=1e-9)


def test_an_element_missing_in_a_good_reply_is_held_or_zero() -> None:
    rsi = _rsi()
    receive = tuple(replace(e, holdon=e.tag != "DiO") for e in rsi.receive)
    peer = Peer(_controller(rsi=replace(rsi, receive=receive)))
    peer.cycle(_step(0.001), dio=1)
    data = peer.reply(NOTHING)
    bare = data[: data.index(b"<AK")] + data[data.index(b"<IPOC") :]
    assert peer.controller.on_reply(bare) is Judgement.ACCEPTED
    applied = peer.controller.end_of_cycle()
    assert applied.setpoints[0] == pytest.approx(0.001)
    assert applied.digital_out == 0


@pytest.mark.parametrize(
    ("rule", "pattern", "ends"),
    [("total", "x.x.x.x.", True), ("row", "x.x.x.x.", False), ("row", "xxxx", True)],
)
def test_the_timeout_counts_in_total_or_in_a_row(rule: str, pattern: str, ends: bool) -> None:
    assert rule in {"total", "row"}
    config = ControllerConfig(timeout=3, timeout_rule="row" if rule == "row" else "total")
    peer = Peer(_controller(config))
    for letter in pattern:
        if peer.controller.broken is not None:
            break
        peer.silent_cycle() if letter == "x" else peer.cycle()
    assert (peer.controller.broken is not None) == ends
    if ends:
        assert "KSS29002" in str(peer.controller.broken)


def test_after_the_end_no_telegram_is_sent_and_the_robot_stands() -> None:
    peer = Peer(_controller(ControllerConfig(timeout=0)))
    moved = peer.cycle(_step(0.001))
    peer.silent_cycle()
    assert peer.controller.telegram() is None
    applied = peer.controller.end_of_cycle()
    assert applied.setpoints == moved.setpoints
    assert applied.outcome is None
    assert peer.controller.counts.sent == 2


def test_a_restart_begins_again_where_the_robot_stands() -> None:
    peer = Peer(_controller(ControllerConfig(timeout=0)))
    moved = peer.cycle(_step(0.001))
    peer.silent_cycle()
    peer.controller.restart()
    assert peer.controller.broken is None
    again = peer.cycle(_step(0.001))
    assert again.setpoints[0] == pytest.approx(moved.setpoints[0] + 0.001, abs=1e-9)
    assert again.ipoc > moved.ipoc + 900


def test_before_the_beginning_nothing_is_charged() -> None:
    peer = Peer(_controller(ControllerConfig(timeout=1, patient=True)))
    for _ in range(5):
        peer.silent_cycle()
    before = peer.cycle()
    peer.controller.begin()
    after = peer.cycle()
    assert after.ipoc == before.ipoc + 12
    assert after.cycle == 0
    assert peer.controller.counts.sent == peer.controller.counts.answered == 1


def test_a_correction_beyond_its_limit_is_clamped_in_silence() -> None:
    low: Seven = (-0.01,) * 7
    high: Seven = (0.01,) * 7
    peer = Peer(_controller(ControllerConfig(correction_low=low, correction_high=high)))
    applied = peer.cycle((0.02, -0.02, 0.0, 0.0, 0.0, 0.0))
    assert applied.clamped
    assert applied.answered
    assert applied.setpoints[0] == pytest.approx(0.01)
    assert applied.setpoints[1] == pytest.approx(START[1] - 0.01)
    assert peer.controller.delay == 0
    assert peer.controller.clamped == 1


def test_corrections_reach_to_the_software_limits_and_not_beyond() -> None:
    controller = _controller()
    applied = Peer(controller).cycle((0.0, 0.0, 0.0, 0.0, 10.0, 0.0))
    assert applied.setpoints[4] == pytest.approx(controller.config.limits[4].high)


def test_the_monitor_stops_the_robot() -> None:
    monitor: Seven = (0.005,) * 7
    peer = Peer(_controller(ControllerConfig(monitor=monitor)))
    applied = peer.cycle(_step(0.006))
    assert applied.setpoints == START
    assert "AXISCORRMON A1" in str(peer.controller.broken)
    assert peer.controller.telegram() is None


def test_the_stop_channel_ends_the_motion() -> None:
    rsi = _rsi()
    stop = replace(rsi.receive[-1], tag="Stop", type="BOOL", index=60)
    controller = _controller(rsi=replace(rsi, receive=(*rsi.receive, stop)))
    peer = Peer(controller)
    peer.cycle(_step(0.001))
    data = peer.reply(_step(0.002)).replace(b"<Stop>0", b"<Stop>1")
    controller.on_reply(data)
    assert controller.end_of_cycle().setpoints[0] == pytest.approx(0.001)
    assert "STOP" in str(controller.broken)


def test_every_closed_cycle_is_exactly_one_of_four() -> None:
    peer = Peer(_controller())
    peer.cycle()
    peer.silent_cycle()
    peer.reply(NOTHING)
    peer.controller.on_reply(b"junk")
    peer.controller.end_of_cycle()
    late = peer.reply(NOTHING)
    peer.controller.end_of_cycle()
    peer.controller.telegram()
    peer.controller.on_reply(late)
    peer.controller.end_of_cycle()
    counts = peer.controller.counts
    assert (counts.answered, counts.late, counts.refused, counts.lost) == (1, 1, 1, 2)
    assert counts.sent == 5


def test_a_reply_without_corrections_holds_the_robot_and_is_not_blamed() -> None:
    peer = Peer(_controller(ControllerConfig()))
    for turn in range(40):
        peer.cycle(_step(2e-5 * turn * turn))
    moving = peer.controller.setpoints
    assert peer.controller.judge.violations == 0
    data = peer.controller.telegram()
    assert data is not None
    ipoc = peer.codec.parse_robot(data).ipoc
    bare = b'<Sen Type="ImFree"><IPOC>%d</IPOC></Sen>' % ipoc
    assert peer.controller.on_reply(bare) is Judgement.ACCEPTED
    assert peer.controller.end_of_cycle().setpoints == moving
    assert peer.controller.judge.violations == 0
    # The same stop by corrections is blamed.
    for turn in range(40):
        peer.cycle(_step(2e-5 * 39 * 39 + 1e-4 * turn * turn))
    peer.cycle(_step(2e-5 * 39 * 39 + 1e-4 * 39 * 39))
    assert peer.controller.judge.violations > 0
