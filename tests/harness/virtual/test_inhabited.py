"""Virtual time: the clock of a machine that is paused stands, the world's goes on."""

import asyncio
import time

import pytest

from linemate.simulators.harness.virtual.inhabited import inhabited
from linemate.simulators.harness.virtual.virtual_loop import VirtualLoop
from linemate.simulators.harness.virtual.virtual_ports import VirtualTimer
from linemate.simulators.harness.virtual.virtual_time import EPOCH_NS, VirtualTime

MS = 1_000_000


@pytest.fixture
def world() -> VirtualTime:
    return VirtualTime()


def test_a_paused_machine_does_not_see_the_time_pass(world: VirtualTime) -> None:
    world.pass_until(EPOCH_NS + 10 * MS)
    world.pause(360 * MS)
    world.pass_until(EPOCH_NS + 300 * MS)
    assert world.host_ns == EPOCH_NS + 10 * MS
    world.pass_until(EPOCH_NS + 370 * MS)
    assert world.host_ns == EPOCH_NS + 10 * MS
    world.pass_until(EPOCH_NS + 400 * MS)
    assert world.host_ns == EPOCH_NS + 40 * MS
    assert world.now_ns == EPOCH_NS + 400 * MS


def test_pauses_add_up_and_one_within_another_is_part_of_it(world: VirtualTime) -> None:
    world.pause(20 * MS)
    world.pass_until(EPOCH_NS + 10 * MS)
    world.pause(20 * MS)
    world.pass_until(EPOCH_NS + 50 * MS)
    assert world.host_ns == EPOCH_NS + 20 * MS
    world.pause(5 * MS)
    world.pass_until(EPOCH_NS + 60 * MS)
    assert world.host_ns == EPOCH_NS + 25 * MS


def test_a_timer_that_was_armed_before_a_pause_expires_by_the_machines_own_clock(
    world: VirtualTime,
) -> None:
    timer = VirtualTimer(world)
    timer.arm(EPOCH_NS + 12 * MS)
    world.pass_until(EPOCH_NS + 5 * MS)
    world.pause(100 * MS)
    world.pass_until(EPOCH_NS + 111 * MS)
    assert not timer.is_ready
    world.pass_until(EPOCH_NS + 112 * MS)
    assert timer.is_ready
    assert timer.fileno() in world.filled


def test_the_loop_of_a_paused_machine_sleeps_that_much_longer(world: VirtualTime) -> None:
    async def sleep() -> tuple[int, int]:
        world.at(EPOCH_NS + 10 * MS, lambda: world.pause(50 * MS))
        await asyncio.sleep(0.020)
        return time.monotonic_ns(), world.now_ns

    with inhabited(world):
        loop = VirtualLoop(world)
        try:
            host_ns, now_ns = loop.run_until_complete(sleep())
        finally:
            loop.close()
    assert host_ns - EPOCH_NS == pytest.approx(20 * MS, abs=MS)
    assert now_ns - EPOCH_NS == pytest.approx(70 * MS, abs=MS)


@pytest.mark.parametrize("rate", [-0.03, 0.03])
def test_a_timer_expires_by_a_machines_clock_that_is_fast_or_slow(
    world: VirtualTime, rate: float
) -> None:
    timer = VirtualTimer(world)
    timer.arm(EPOCH_NS + 100 * MS)
    world.set_rate(rate)
    world.pass_until(EPOCH_NS + 50 * MS)
    assert world.host_ns - EPOCH_NS == pytest.approx((1.0 + rate) * 50 * MS, abs=1)
    timer.arm(EPOCH_NS + 200 * MS)
    due_ns = EPOCH_NS + 200 * MS / (1.0 + rate)
    world.pass_until(round(due_ns) - MS)
    assert not timer.is_ready
    world.pass_until(round(due_ns) + MS)
    assert timer.is_ready
    assert timer.fileno() in world.filled


def test_a_clock_whose_rate_changes_does_not_step(world: VirtualTime) -> None:
    before_ns = world.host_ns
    for n, rate in enumerate((0.01, -0.02, 0.0, 0.03), 1):
        world.set_rate(rate)
        assert world.host_ns == before_ns
        world.pass_until(EPOCH_NS + 10 * n * MS)
        assert world.host_ns - before_ns == pytest.approx((1.0 + rate) * 10 * MS, abs=1)
        before_ns = world.host_ns
