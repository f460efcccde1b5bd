"""The journal is bounded, and says how much it left out; sensors come and go by their names."""

from linemate.daemon.cycle.sensing.samples import SensorFact
from linemate.daemon.service.journal import Journal, SensorChanges

MS = 1_000_000
LIMITS = {"camera": 0.3, "distance": 0.3}


def test_a_second_has_no_more_lines_than_allowed_and_nothing_is_lost_unsaid() -> None:
    lines: list[tuple[int, str]] = []
    now = [0]
    journal = Journal(lambda text: lines.append((now[0], text)), 3)
    for n in range(200):
        now[0] = n * 5 * MS
        journal.write_line(now[0], f"line {n}")
    now[0] = 6000 * MS
    journal.catch_up(now[0])
    for at_ns, _ in lines:
        assert sum(at_ns <= other < at_ns + 1000 * MS for other, _ in lines) <= 3
    texts = " | ".join(text for _, text in lines).split(" | ")
    assert texts[:4] == ["line 0", "line 1", "line 2", "line 3"]
    left_out = [int(text.split()[0]) for text in texts if "more" in text]
    assert sum(left_out) + sum(text.startswith("line") for text in texts) == 200
    assert sum(left_out) > 0


def test_a_line_beyond_the_limit_waits_for_it() -> None:
    lines: list[str] = []
    journal = Journal(lines.append, 1)
    for n in range(4):
        journal.write_line(n * MS, f"line {n}")
    assert lines == ["line 0"]
    journal.catch_up(999 * MS)
    assert lines == ["line 0"]
    journal.catch_up(1000 * MS)
    assert lines == ["line 0", "line 1 | line 2 | line 3"]


def test_few_lines_are_all_written() -> None:
    lines: list[str] = []
    journal = Journal(lines.append, 3)
    for n in range(10):
        journal.write_line(n * 400 * MS, str(n))
        journal.catch_up(n * 400 * MS)
    assert lines == [str(n) for n in range(10)]


def test_a_sensor_is_reported_when_it_comes_goes_and_comes_back() -> None:
    sensors = SensorChanges()

    def at(now_ms: int, stamp_ms: int | None, excluded: str | None = None) -> list[str]:
        stamp_ns = None if stamp_ms is None else stamp_ms * MS
        return sensors.changes(now_ms * MS, {"camera": SensorFact(stamp_ns, excluded)}, LIMITS)

    assert at(0, None) == []
    assert at(10, 5) == ["sensor camera in"]
    assert at(200, 190) == []
    assert at(500, 190) == ["sensor camera out: silent for 0.31 s, limit 0.30 s. Check its link."]
    assert at(900, 190) == []
    assert at(1500, 1490) == ["sensor camera in after 1.00 s"]
    assert at(1600, 1590, "4 poses alike") == [
        "sensor camera out: excluded, 4 poses alike. Check its link."
    ]


def test_a_camera_that_the_tool_covers_needs_no_check() -> None:
    sensors, seen = SensorChanges(), {"camera": SensorFact(5 * MS)}
    sensors.changes(10 * MS, seen, LIMITS)
    (line,) = sensors.changes(500 * MS, seen, LIMITS, frozenset({"camera"}))
    assert line.endswith("limit 0.30 s. The tool covers it.")


def test_a_sensor_that_was_never_there_is_not_called_out() -> None:
    sensors = SensorChanges()
    for n in range(100):
        assert sensors.changes(n * 100 * MS, {"distance": SensorFact()}, LIMITS) == []
