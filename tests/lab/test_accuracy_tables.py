"""Tables: a bar is met by the seeds that no one tuned on, or it is not met."""

import math
from typing import Any

import pytest

from linemate.simulators.judge.statistics import describe
from linemate.simulators.lab import accuracy_tables as tables
from linemate.simulators.lab.accuracy_tables import Bar
from linemate.simulators.lab.detection import latencies, rate

WINDOWS = ("approach", "stop", "impact", "contact", "restart")


def run(**changed: Any) -> dict[str, Any]:
    found: dict[str, Any] = {"assembled": True, "limits.violations": 0, "false_alarms.confirmed": 0}
    for error in ("control", "plan", "prediction", "total"):
        for window in WINDOWS:
            found[f"{error}_error.{window}.max_mm"] = 0.1
            found[f"{error}_error.{window}.max_mrad"] = 0.2
    return found | {name.replace("__", "."): value for name, value in changed.items()}


def stop(mm: float) -> dict[str, Any]:
    return run(total_error__stop__max_mm=mm)


@pytest.mark.parametrize(
    ("values", "held"),
    [([0.2, 0.2, 0.5], True), ([0.4, 0.4, 0.5], False), ([0.2, 0.2, 0.7], False)],
)
def test_a_bar_bounds_the_median_and_the_worst(values: list[float], held: bool) -> None:
    assert Bar(0.3, 0.6).holds(describe(values)) is held


def test_what_is_missing_in_a_run_does_not_hold_a_bar() -> None:
    assert not Bar(0.3, 0.6).holds(describe([0.1, 0.1, math.inf]))
    assert Bar(0.3).holds(describe([0.1, 0.1, math.inf]))


def test_control_is_the_largest_over_all_windows_of_a_run_that_assembled() -> None:
    assert tables.value(run(control_error__restart__max_mm=0.4), "control.max_mm") == 0.4
    assert tables.value(run(assembled=False), "control.max_mm") == math.inf
    assert tables.value(run(), "total_error.quiet.max_mm") == math.inf


def test_the_bar_rests_on_the_seeds_that_verify() -> None:
    good, bad = [stop(1.0)] * 3, [stop(5.0)] * 3
    met = dict(tables.bars_met({"wheel": {"tuned": good, "verify": bad}}, {}))
    assert met["total after a stop in the approach, mm"] is False
    met = dict(tables.bars_met({"wheel": {"tuned": bad, "verify": good}}, {}))
    assert met["total after a stop in the approach, mm"] is True
    assert not tables.bars_met({"wheel": {"tuned": good}}, {})


def test_both_groups_are_next_to_the_bar() -> None:
    text = tables.claims({"wheel": {"tuned": [stop(1.0)], "verify": [stop(3.0)]}})
    row = next(line for line in text.splitlines() if "after a stop in the approach" in line)
    assert row.split(" | ")[1:] == [
        "1 (1)", "3 (3)", "≤ 2.4 (3.4)", "1.7 (2.6)", "**no** |"
    ]  # fmt: skip


def test_a_wrong_model_is_compared_with_nominal_on_the_same_seeds() -> None:
    nominal = [stop(1.0)] * 2 + [stop(9.0)] * 8
    runs = {"wheel": {"verify": nominal}, "swing-1.05": {"verify": [stop(1.4)] * 2}}
    assert dict(tables.bars_met(runs, {}))["swing frequency +5 %"] is True
    assert "×1.40" in tables.wrong(runs)
    runs["swing-1.05"] = {"verify": [stop(1.6)] * 2}
    assert dict(tables.bars_met(runs, {}))["swing frequency +5 %"] is False
    runs["swing-1.05"] = {"verify": [run(assembled=False), stop(1.0)]}
    assert dict(tables.bars_met(runs, {}))["swing frequency +5 %"] is False


def test_without_nominal_on_as_many_seeds_there_is_no_bar() -> None:
    runs = {"wheel": {"verify": [stop(1.0)]}, "swing-1.05": {"verify": [stop(1.0)] * 2}}
    assert "swing frequency +5 %" not in dict(tables.bars_met(runs, {}))


def test_detection_is_held_to_its_bars() -> None:
    found = {
        "free": {
            "stop": {"perceived_s": latencies([0.15]), "confirmed_s": latencies([math.inf])},
            "false_per_hour": {"stop": {"confirmed": rate(30, 20.0)}},
        },
        "jerk": {"made": 200, "not_taken": {"share": 0.995, "ci95": [0.97, 1.0]}},
    }
    met = dict(tables.bars_met({}, {"12 default": found}))
    assert met == {
        "stop perceived, s": True,
        "stop confirmed, s": False,
        "false stops, /h": False,
        "jerks not taken for a stop": True,
    }
    text = tables.asked({"12 default": found})
    assert "| false stops, /h | 1.50 [1.01, 2.14] (30) | ≤ 1 | 0.1 | **no** |" in text
    assert "| jerks not taken for a stop | 0.995 [0.970, 1.000] | ≥ 0.98 | 0.995 | yes |" in text


def test_tables_without_figures_are_left_out() -> None:
    assert not tables.tables({}, {})
    text = tables.tables({"wheel": {"verify": [run()]}}, {})
    assert "## Figures and bars" in text
    assert "Detection" not in text
    assert "Models wrong" not in text


def test_every_line_of_a_table_has_as_many_cells_as_its_head() -> None:
    runs = {
        name: {"tuned": [run()] * 2, "verify": [run()] * 2}
        for name in ("wheel", "oracle", "rule", "mode-0.9", "no-swing")
    }
    for block in tables.tables(runs, {}).split("\n\n"):
        if block.startswith("|"):
            assert len({line.count(" | ") for line in block.splitlines()}) == 1
