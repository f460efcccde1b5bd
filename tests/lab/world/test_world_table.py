"""The table of the realistic world: medians, sums, and reasons of what was not assembled."""

from typing import Any

from linemate.simulators.lab.world import measure, world_table


def run(seed: int, **changed: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "row": "x", "seed": seed, "outcome": "assembled", "reason": None, "missed": 0,
        "control_rms_mm": 0.1, "control_mm": 0.2, "impact_mm": 0.3, "stop_mm": 2.0,
        "start_s": 0.3, "force_n": 55.0, "false_tentative": 1, "false_confirmed": 0,
        "oscillation_mm": 0.04, "energy_j": 0.01,
    }  # fmt: skip
    return plain | changed


def test_a_missed_start_counts_as_infinite() -> None:
    summary = world_table.summarise([run(0), run(1), run(2, start_s=None, missed=1)])
    assert summary["start_s"]["worst"] is None
    assert summary["start_s"]["median"] == 0.3
    assert summary["missed"] == 1
    assert summary["false_tentative"] == 3


def test_outcomes_are_counted_and_reasons_printed() -> None:
    runs = [run(0), run(1, outcome="collision", reason="the mount broke away", impact_mm=9.0)]
    summary = world_table.summarise(runs)
    assert world_table.outcomes(summary) == "1 assembled, 1 collision"
    assert summary["impact_mm"]["worst"] == 9.0
    printed = world_table.text({"rows": {"x": {"summary": summary, "runs": runs}}})
    assert "x seed 1: collision: the mount broke away" in printed
    assert "4.65 (9)" in printed


def test_a_row_names_its_seeds_and_those_of_its_worst_runs() -> None:
    runs = [run(0), run(1, impact_mm=0.9), run(2, false_confirmed=3), run(7, impact_mm=None)]
    summary = world_table.summarise(runs)
    assert summary["seeds"] == "0..2,7"
    assert summary["impact_mm"]["worst_seed"] == 1
    assert summary["impact_mm"]["n"] == 3
    assert summary["false_confirmed_seeds"] == "2"
    assert summary["missed_seeds"] == ""
    assert world_table.summarise([run(4, start_s=None), run(5)])["start_s"]["worst_seed"] == 4


def test_a_figure_that_no_run_has_is_a_dash() -> None:
    assert world_table.spread(world_table.summarise([run(0, impact_mm=None)])["impact_mm"]) == "-"


def test_the_figures_of_a_judged_run_are_by_its_first_stop_and_start() -> None:
    span = {"max_mm": 1.0, "rms_mm": 0.5, "max_mrad": 2.0, "rms_mrad": 1.0}
    error = dict.fromkeys(("approach", "stop", "impact", "contact"), span)
    found = measure.figures({
        "seed": 1, "cycle_ms": 12, "outcome": "held", "reason": "why",
        "control_error": error, "total_error": error, "contact_force_n": None,
        "contact": {"oscillation_mm": {"first": 0.4, "last": 0.2, "worst": 0.5},
                    "energy_j": {"last": 0.1, "worst": 0.3}},
        "detection": [
            {"event": "stop", "confirmed_s": 0.1},
            {"event": "start", "confirmed_s": None},
            {"event": "stop", "confirmed_s": 0.9},
        ],
        "false_alarms": {"tentative": 2, "confirmed": 1}, "limits": {"violations": 0},
    })  # fmt: skip
    assert (found["stop_s"], found["start_s"], found["missed"]) == (0.1, None, 1)
    assert (found["false_tentative"], found["false_confirmed"]) == (2, 1)
    assert found["force_n"] is None
    assert (found["oscillation_mm"], found["energy_j"]) == (0.5, 0.3)
    assert found["stop_mm"] == 1.0


def test_a_run_that_never_touched_has_no_error_after_a_stop() -> None:
    span = {"max_mm": 345.0, "rms_mm": 99.0, "max_mrad": 2.0, "rms_mrad": 1.0}
    error = {"approach": None, "stop": span, "impact": None, "contact": None}
    found = measure.figures({
        "seed": 1, "cycle_ms": 12, "outcome": "held", "reason": "why",
        "control_error": error, "total_error": error, "contact_force_n": None, "contact": None,
        "detection": [],
        "false_alarms": {"tentative": 0, "confirmed": 0}, "limits": {"violations": 0},
    })  # fmt: skip
    assert found["stop_mm"] is None
    assert (found["oscillation_mm"], found["energy_j"]) == (None, None)
