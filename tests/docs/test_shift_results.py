"""Table of a shift: counts, and each car that was not mounted."""

from typing import Any

from docs.make import shift_results


def car(name: str, *, mounted: bool = True, **changed: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "id": name, "variant": "suv", "fault": None, "outcome": "ok", "reason": "",
        "mounted": mounted, "collision": None, "impact_mm": 0.2, "force_n": 90.0,
        "cause_named": True, "duration_s": 23.0,
    }  # fmt: skip
    return plain | changed


def raw() -> dict[str, Any]:
    lost = {"mounted": False, "outcome": "nok", "impact_mm": None, "force_n": None}
    return {
        "cars": [
            car("P1"),
            car("P2", impact_mm=0.6, force_n=120.0),
            car("P3", fault="camera covered", reason="no camera", **lost),
            car("P4", fault="part missing", reason="overload", cause_named=False, **lost),
            car("P5", reason="drifted", **lost),
        ],
        "collisions": 0, "mounted_bad": 0, "unreported": 0, "complaints": [],
        "duration_s": 7200.0, "requests": {"arm": 0, "announce": 5},
        "remembered_bytes": [[2_000_000, 2_100_000]], "resident_bytes": [[0, 0], [10**8, 10**8]],
        "record_bytes": 5000, "planned": 9,
    }  # fmt: skip


def test_good_and_faulty_cars_are_counted_apart() -> None:
    figures = shift_results.condensed(raw())
    assert (figures["good_mounted"], figures["good_cars"]) == (2, 3)
    assert figures["faults"]["camera covered"] == {"cars": 1, "named": 1, "mounted": 0}
    assert figures["faults"]["part missing"]["named"] == 0
    assert figures["impact_mm"] == [0.4, 0.6]
    assert [each["id"] for each in figures["not_mounted"]] == ["P3", "P4", "P5"]


def test_the_table_has_a_row_for_each_car_that_was_not_mounted() -> None:
    figures = shift_results.condensed(raw())
    text = shift_results.table(lambda _: figures, lambda _: True)
    assert "| cars | 5 of 9 planned, " in text
    assert "| good cars mounted | 2 of 3 |" in text
    assert "| part missing: cause reported | 0 of 1 |" in text
    assert "| P5 suv | none | drifted |" in text
    assert "100.00 MB, 100.00 MB" in text
    assert "arm 0, start 0" in text


def test_what_was_not_measured_is_not_claimed() -> None:
    assert "make results" in shift_results.table(lambda _: {}, lambda _: False)
