"""The page of a day: yield, causes, drift and worst parts, from records alone."""

import re
from html.parser import HTMLParser
from typing import Any

import pytest

from linemate.daemon.production import day_report


def record(number: int, **changes: Any) -> dict[str, Any]:
    return {
        "at": "2026-11-23T08:00:00Z",
        "station": "left",
        "part": f"P{number}",
        "variant": "sedan",
        "ok": True,
        "reason": "",
        "duration_s": 20.0,
        "estimates": {"prediction_mm": 1.0, "sigma_mm": 0.2},
        "reach_mm": 0.0,
        "force": {"impact_n": 50.0, "largest_n": 90.0},
        "replies_lost": 0,
        "recording": "/var/lib/linemate/a.mcap",
    } | changes


class Reader(HTMLParser):
    """Text of a page, and whether its tags close."""

    def __init__(self) -> None:
        super().__init__()
        self.text = ""
        self.links: list[str] = []
        self.tags: list[str] = []

    def handle_data(self, data: str) -> None:
        self.text += data + "\n"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.tags.append(tag)
        self.links += [value or "" for name, value in attrs if name == "href"]


def read(records: list[dict[str, Any]]) -> Reader:
    reader = Reader()
    reader.feed(day_report.page(records, "2026-11-23"))
    return reader


def test_the_yield_and_the_causes_are_counted() -> None:
    bad = record(2, ok=False, reason="no fresh force: force_torque silent", variant="van")
    page = read([record(1), bad, record(3), record(4)])
    assert "75.0 %" in page.text
    assert re.search(r"no fresh force\n1\n", page.text)
    assert re.search(r"van\n1\n0\n0.0 %", page.text)


def test_a_drift_is_marked_only_if_it_is_larger_than_its_deviation() -> None:
    noise = [0.3, -0.2, 0.1, -0.3, 0.2, -0.1, 0.0, 0.25, -0.25, 0.15, -0.05, 0.05]
    steady = [50.0 + n for n in noise]
    rising = [50.0 + n + 0.5 * i for i, n in enumerate(noise)]
    for values, word in ((steady, "no drift"), (rising, "drifts by")):
        force = [{"impact_n": v, "largest_n": 90.0} for v in values]
        page = read([record(i, force=each) for i, each in enumerate(force)])
        (note,) = [line for line in page.text.splitlines() if "N in 100 parts" in line][:1]
        assert word in note


def test_values_that_are_all_equal_are_called_constant_and_have_no_rounding_error() -> None:
    page = read([record(i, estimates={"sigma_mm": 0.2}) for i in range(12)])
    assert "mm in 100 parts" not in page.text
    assert page.text.count("constant\n") >= 2
    rising = [record(i, estimates={"sigma_mm": 0.25 * i}) for i in range(12)]
    assert "drifts by 25 mm in 100 parts" in read(rising).text


def test_a_bad_part_has_its_time_of_day_and_a_stamp_of_another_form_stays() -> None:
    late = record(1, ok=False, reason="overload", at="2026-11-23T09:32:10Z")
    page = read([late, record(2, ok=False, reason="overload", at="unknown")])
    assert "\n09:32:10\n" in page.text
    assert "\nunknown\n" in page.text


def test_the_slope_of_a_line_is_found_with_its_deviation() -> None:
    slope, deviation = day_report.drift([2.0 + 0.5 * i for i in range(10)]) or (0.0, 1.0)
    assert slope == pytest.approx(0.5)
    assert deviation == pytest.approx(0.0, abs=1e-12)
    assert day_report.drift([1.0] * 7) is None


def test_the_worst_good_part_is_linked_to_its_recording() -> None:
    worst = record(2, force={"impact_n": 80.0, "largest_n": 95.0}, recording="/data/b.mcap")
    bad = record(3, ok=False, reason="overload", force={"impact_n": 400.0, "largest_n": 400.0})
    page = read([record(1), worst, bad])
    after = page.text[page.text.index("Worst good parts") :]
    assert re.search(r"Force at impact\n80 N\nP2\n", after)
    assert "/data/b.mcap" in page.links


def test_a_text_from_a_record_is_never_markup() -> None:
    page = read([record(1, part="<script>x</script>", ok=False, reason="<b>&'\"")])
    assert "script" not in page.tags
    assert "<script>x</script>" in page.text


def test_a_day_without_parts_and_records_without_figures_make_a_page() -> None:
    assert "0 parts" in read([]).text
    bare = record(1, estimates={}, force={"impact_n": None, "largest_n": None}, recording=None)
    assert "1 part\n" in read([bare]).text
    assert day_report.value({"a": {"b": float("nan")}}, ("a", "b")) is None
    assert day_report.value({"a": True}, ("a",)) is None
