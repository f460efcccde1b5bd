import pytest

from linemate.protocol.sensors.wrench_clock import MOST_REPEATS, STEADY_NS, WRAP_US, WrenchClock
from linemate.protocol.stamped_samples import WrenchSample

PERIOD_NS = 4_000_000


def sample(stamp_ns: int, device_us: int | None) -> WrenchSample:
    return WrenchSample(stamp_ns, (0.0, 0.0, 1.0), (0.0, 0.0, 0.0), 0, device_us)


def dated(lateness_ns: list[int], first_us: int = 0) -> list[int]:
    """How late each sample still looks, when it was read that late."""
    clock = WrenchClock()
    return [
        clock.date(
            sample(10**12 + k * PERIOD_NS + late, (first_us + k * PERIOD_NS // 1000) % WRAP_US)
        ).stamp_ns
        - (10**12 + k * PERIOD_NS)
        for k, late in enumerate(lateness_ns)
    ]


def test_a_frame_that_was_read_late_is_dated_when_it_came() -> None:
    assert dated([300, 300, 9_000_000, 300, 25_000_000]) == [300] * 5


def test_a_late_first_frame_is_soon_forgotten() -> None:
    assert dated([5_000_000, 100, 100, 7_000_000])[1:] == [100, 100, 100]


def test_the_devices_clock_may_wrap() -> None:
    assert dated([0, 0, 3_000_000, 0, 0], first_us=WRAP_US - 6_000) == [0] * 5


def test_a_device_without_a_clock_keeps_its_arrival() -> None:
    plain = sample(123, None)
    assert WrenchClock().date(plain) is plain


def test_a_clock_that_stands_is_not_believed_for_long() -> None:
    clock = WrenchClock()
    late = []
    for k in range(200):
        stamp = k * PERIOD_NS
        late.append(stamp - clock.date(sample(stamp, 7)).stamp_ns)
    assert max(late) <= PERIOD_NS
    assert set(late[MOST_REPEATS + 1 :]) == {0}
    assert clock.distrusted > 5


def test_a_frame_that_comes_twice_is_dated_by_its_count() -> None:
    clock = WrenchClock()
    for k in range(10):
        stamp = k * PERIOD_NS
        first = clock.date(sample(stamp, stamp // 1000))
        again = clock.date(sample(stamp + 3_000_000, stamp // 1000))
        assert first.stamp_ns == again.stamp_ns == stamp
    assert clock.distrusted == 0


@pytest.mark.parametrize("back_us", [10_000, 15_000, 25_000, 45_000])
def test_a_clock_that_was_set_back_a_little_is_dated_by_arrival_before_long(back_us: int) -> None:
    clock = WrenchClock()
    off = []
    for k in range(200):
        device_us = 10**9 + k * PERIOD_NS // 1000 - (back_us if k >= 100 else 0)
        stamp = k * PERIOD_NS + 300_000
        off.append(stamp - clock.date(sample(stamp, device_us)).stamp_ns)
    assert off[:100] == [0] * 100
    assert set(off[100 + STEADY_NS // PERIOD_NS + 2 :]) == {0}
    assert clock.distrusted == 1


def test_a_delayed_line_that_drains_keeps_the_clock_in_use() -> None:
    """For 48 ms nothing is read, and then all at once: each frame is dated when it came."""
    delayed_ns = [48_000_000 - k * PERIOD_NS for k in range(12)]
    lateness = ([300] * 5 + delayed_ns) * 10
    assert dated(lateness) == [300] * len(lateness)


def test_the_offset_of_a_restarted_device_is_learned_again() -> None:
    clock = WrenchClock()
    for k in range(10):
        clock.date(sample(k * PERIOD_NS, 3_000_000_000 + k * 4000))
    restarted = clock.date(sample(10 * PERIOD_NS, 0))
    later = clock.date(sample(11 * PERIOD_NS + 2_000_000, 4000))
    assert 0 <= restarted.stamp_ns <= 10 * PERIOD_NS
    assert abs(later.stamp_ns - 11 * PERIOD_NS) <= 2_000_000
