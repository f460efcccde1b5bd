"""Times are kept in fixed size, and the ring is there when something went wrong."""

import csv

from msgspec.structs import replace

from linemate.daemon.cycle.clock.timing import COLUMNS, PAUSE_S, CycleTimes, Timing

MS = 1_000_000
CYCLE = CycleTimes(
    counter=1, arrival_ns=0, expected_ns=0, woken_late_ns=20_000, lead_ns=400_000, step_ns=250_000,
    turnaround_ns=60_000, prepared=True, state="track",
)  # fmt: skip


def at(n: int, **changed: object) -> CycleTimes:
    return replace(CYCLE, counter=n, arrival_ns=n * 4 * MS, **changed)  # type: ignore[arg-type]


def test_the_ring_holds_two_seconds_and_no_more() -> None:
    timing = Timing(4 * MS)
    for n in range(5000):
        timing.note(at(n))
    ring = timing.last()
    assert len(ring) == 500
    assert (ring[0].counter, ring[-1].counter) == (4500, 4999)


def test_a_late_reply_takes_the_ring_with_itself_as_its_last_cycle() -> None:
    timing = Timing(4 * MS)
    for n in range(1000):
        timing.note(at(n))
    assert timing.take_incident() is None
    timing.note(at(1000, turnaround_ns=4 * MS + 1))
    incident = timing.take_incident()
    assert incident is not None
    assert incident.why == "a reply was late"
    assert incident.cycles[-1].counter == 1000
    assert len(incident.cycles) == 500
    assert timing.take_incident() is None
    assert timing.late == 1


def test_a_bad_hour_does_not_write_a_ring_for_every_cycle() -> None:
    timing = Timing(4 * MS)
    cycles = 250 * 60
    taken = 0
    for n in range(cycles):
        timing.note(at(n, turnaround_ns=5 * MS))
        taken += timing.take_incident() is not None
    assert timing.late == cycles
    assert taken == timing.incidents == 60 / PAUSE_S


def test_a_ring_reads_back_as_comma_separated_values() -> None:
    timing = Timing(4 * MS)
    timing.note(at(1))
    timing.note(replace(at(2), counter=None, turnaround_ns=None))
    timing.incident("fault: the robot link is lost", 8 * MS)
    incident = timing.take_incident()
    assert incident is not None
    head, *rows = incident.lines()
    assert "the robot link is lost" in head
    read = list(csv.DictReader(rows))
    assert tuple(read[0]) == COLUMNS
    assert [row["counter"] for row in read] == ["1", ""]
    assert read[1]["turnaround_ns"] == ""
    assert read[0]["state"] == "track"


def test_a_missing_telegram_has_no_turn_around() -> None:
    timing = Timing(4 * MS)
    timing.note(replace(CYCLE, counter=None, turnaround_ns=None))
    assert timing.missing == 1
    assert timing.turnaround.count == 0
    assert timing.step.count == 1


def test_the_summary_tells_percentiles_in_microseconds() -> None:
    timing = Timing(4 * MS)
    for n in range(1, 1001):
        timing.note(at(n, turnaround_ns=n * 1000))
        timing.note_age("camera", 25 * MS)
    summary = timing.summary()
    assert 500 <= summary["turnaround_us"]["p50"] <= 545
    assert summary["turnaround_us"]["max"] == 1000.0
    assert summary["age_us"]["camera"]["max"] == 25_000.0
    assert summary["age_us"]["wrench"]["p50"] is None
    assert summary["late"] == summary["missing"] == 0
