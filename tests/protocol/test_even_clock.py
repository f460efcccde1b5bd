"""Readings that were read late get the date at which they came, and nothing else is touched."""

import random

from linemate.protocol.sensors.even_clock import EvenClock
from linemate.protocol.stamped_samples import DistanceSample

PERIOD_NS = 4_000_000
BEGIN_NS = 10**12


def readings(*stamps_ns: int) -> list[DistanceSample]:
    return [DistanceSample(stamp_ns, 0.0) for stamp_ns in stamps_ns]


def taught(period_ns: int = PERIOD_NS, count: int = 64) -> EvenClock:
    """A clock that has seen `count` readings; the last came at BEGIN_NS."""
    clock = EvenClock()
    for k in range(1 - count, 1):
        clock.date(readings(BEGIN_NS + k * period_ns))
    assert clock.redated == 0
    return clock


def dates(clock: EvenClock, *late_ms: float) -> list[float]:
    """How late readings 1, 2, ... still look [ms] that were read so late in one portion."""
    came = [BEGIN_NS + (k + 1) * PERIOD_NS for k in range(len(late_ms))]
    read = [at + round(1e6 * late) for at, late in zip(came, late_ms, strict=True)]
    dated = clock.date(readings(*read))
    return [(s.stamp_ns - at) / 1e6 for s, at in zip(dated, came, strict=True)]


def test_a_portion_that_was_read_at_once_is_spread_over_the_time_in_which_it_came() -> None:
    late = dates(taught(), 12.1, 8.1, 4.1, 0.1)
    assert all(abs(error) < 0.4 for error in late)


def test_a_single_reading_that_was_read_late_is_dated_when_it_came() -> None:
    (late,) = dates(taught(), 1.9)
    assert 0.0 <= late < 0.1


def test_what_was_read_in_time_is_the_same_object() -> None:
    clock = taught()
    for k in range(1, 100):
        (sample,) = readings(BEGIN_NS + k * PERIOD_NS + (k % 3) * 100_000)
        assert clock.date([sample])[0] is sample
    assert clock.redated == 0


def test_a_lost_reading_moves_no_date() -> None:
    clock = taught()
    (sample,) = readings(BEGIN_NS + 2 * PERIOD_NS)
    assert clock.date([sample])[0] is sample
    (sample,) = readings(BEGIN_NS + 9 * PERIOD_NS)
    assert clock.date([sample])[0] is sample


def test_a_sensor_that_measures_unevenly_is_left_alone() -> None:
    source = random.Random(1)
    clock, at = EvenClock(), BEGIN_NS
    for _ in range(500):
        at += round(PERIOD_NS * source.choice((0.3, 1.0, 2.7)))
        (sample,) = readings(at)
        assert clock.date([sample])[0] is sample


def test_a_sensor_whose_phase_has_moved_is_followed() -> None:
    clock = taught()
    shift = 1_500_000
    for k in range(1, 400):
        (last,) = clock.date(readings(BEGIN_NS + k * PERIOD_NS + shift))
    assert BEGIN_NS + 399 * PERIOD_NS + shift - last.stamp_ns <= PERIOD_NS // 8
    (early,) = clock.date(readings(BEGIN_NS + 400 * PERIOD_NS))
    assert early.stamp_ns == BEGIN_NS + 400 * PERIOD_NS


def test_the_period_of_a_slower_sensor_is_learned_again() -> None:
    clock = taught()
    for k in range(1, 200):
        (sample,) = readings(BEGIN_NS + k * 3 * PERIOD_NS)
        (last,) = clock.date([sample])
    assert last is sample
    (late,) = clock.date(readings(BEGIN_NS + 600 * PERIOD_NS + 5_000_000))
    assert abs(late.stamp_ns - (BEGIN_NS + 600 * PERIOD_NS)) < 200_000


def test_dates_grow_and_are_never_later_than_the_reading() -> None:
    source = random.Random(2)
    clock, last = taught(), BEGIN_NS
    k = dated = 0
    for _ in range(300):
        count = source.randint(0, 5)
        read = BEGIN_NS + (k + count) * PERIOD_NS + source.randint(0, 2 * PERIOD_NS)
        k += count
        portion = [DistanceSample(read + i, float(i)) for i in range(count)]
        for sample in clock.date(portion):
            was = portion[int(sample.position)]
            assert sample.stamp_ns > last or sample.stamp_ns <= was.stamp_ns
            assert sample.stamp_ns <= max(was.stamp_ns, last + 1)
            last = sample.stamp_ns
            dated += 1
    assert dated > 500


def test_a_reading_late_by_more_than_a_period_is_left_out_until_its_date_is_known() -> None:
    # Dated by its arrival it would show the conveyor 1.3 mm short, and so would those after it.
    clock = taught(period_ns=12_000_000)
    came_ms = (12.0, 24.0, 50.6, 100.5, 100.5, 100.5, 100.5, 109.3, 124.7, 124.7, 132.9, 145.0)
    errors, waiting = {}, []
    for k, (at, after) in enumerate(zip(came_ms, (*came_ms[1:], 999.0), strict=True), 1):
        waiting.append(DistanceSample(BEGIN_NS + round(1e6 * at), float(k)))
        if after > at:
            for sample in clock.date(waiting):
                when = BEGIN_NS + 12_000_000 * sample.position
                errors[int(sample.position)] = 1e-6 * (sample.stamp_ns - when)
            waiting.clear()
    assert set(errors) == {1, 2, 9, 10, 11, 12}
    assert clock.undated == 6
    assert all(abs(error) < 2.0 for error in errors.values())


def test_readings_that_come_at_once_after_a_late_one_are_not_dated_by_it() -> None:
    # Dated all at once they were a step of 4 mm, which the estimate kept as an offset.
    clock = taught(period_ns=12_000_000)
    (late,) = clock.date(readings(BEGIN_NS + 132_000_000))
    assert late.stamp_ns == BEGIN_NS + 132_000_000  # after 0.1 s those before it seem to be lost
    portion = [DistanceSample(BEGIN_NS + 144_000_000 + k, float(k)) for k in range(2, 13)]
    dated = clock.date(portion)
    assert dated[-1].position == 12.0
    for sample in dated:
        assert abs(sample.stamp_ns - BEGIN_NS - 12_000_000 * sample.position) < 1_000_000
    assert clock.undated == len(portion) - len(dated) > 0


def test_the_reading_after_lost_ones_is_dated() -> None:
    source = random.Random(4)
    clock = taught()
    for k in range(1, 500):
        if source.random() < 0.6:
            continue
        (sample,) = readings(BEGIN_NS + k * PERIOD_NS + source.randint(0, 400_000))
        assert clock.date([sample]) != []


def test_readings_of_unknown_date_are_taken_again_after_a_while() -> None:
    clock = taught(period_ns=12_000_000)
    apart_ns = 28_800_000  # as if one and a half readings were missing each time
    taken = [bool(clock.date(readings(BEGIN_NS + k * apart_ns))) for k in range(1, 9)]
    assert taken == [False, False, False, True, False, False, False, True]


def test_a_conveyor_that_runs_evenly_stays_even_on_a_host_that_reads_in_portions() -> None:
    source = random.Random(3)
    clock = EvenClock()
    waiting: list[int] = []
    worst = 0
    for k in range(3000):
        waiting.append(k)
        if source.random() < 0.1 and len(waiting) < 5:
            continue  # the host does something else
        read = BEGIN_NS + k * PERIOD_NS + source.randint(0, 300_000)
        portion = readings(*[read + 50_000 * i for i in range(len(waiting))])
        for n, sample in zip(waiting, clock.date(portion), strict=True):
            if k > 200:
                worst = max(worst, abs(sample.stamp_ns - BEGIN_NS - n * PERIOD_NS))
        waiting.clear()
    assert worst < PERIOD_NS // 3


def test_nothing_is_dated_before_there_is_a_reading() -> None:
    assert list(EvenClock().date([])) == []


def test_the_first_portion_is_dated_by_its_own_readings() -> None:
    clock = EvenClock()
    portion = readings(*(BEGIN_NS + k * PERIOD_NS for k in range(40)))
    assert [s.stamp_ns for s in clock.date(portion)] == [s.stamp_ns for s in portion]
    assert clock.redated == 0
