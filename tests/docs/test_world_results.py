"""Tables of the realistic world: what was measured is shown, what was not is not claimed."""

from typing import Any

from docs.make import world_results
from linemate.simulators.harness.world import world_rows
from linemate.simulators.lab.world import world_table


def run(seed: int, **changed: Any) -> dict[str, Any]:
    plain: dict[str, Any] = {
        "seed": seed, "outcome": "assembled", "reason": None, "missed": 0, "control_rms_mm": 0.1,
        "control_mm": 0.2, "impact_mm": 0.3, "stop_mm": 2.0, "start_s": 0.3, "force_n": 55.0,
        "oscillation_mm": 0.04, "energy_j": 0.01, "false_tentative": 1, "false_confirmed": 0,
    }  # fmt: skip
    return plain | changed


def raw(*names: str) -> dict[str, Any]:
    runs = [run(0), run(1, outcome="held", reason="blind", impact_mm=None, start_s=None)]
    row = {"what": "w", "runs": runs, "summary": world_table.summarise(runs)}
    return {"version": 1, "rows": dict.fromkeys(names, row)}


def test_a_condensed_row_has_its_summary_and_each_run_that_was_not_assembled() -> None:
    figures = world_results.condensed(raw("nominal"))["nominal"]
    assert figures["not_assembled"] == [{"seed": 1, "outcome": "held", "reason": "blind"}]
    assert figures["summary"]["seeds"] == "0..1"
    assert figures["summary"]["assembled"] == 1
    assert "runs" not in figures


def test_a_result_that_was_not_measured_is_a_dash_and_no_claim() -> None:
    stored = world_results.condensed(raw("nominal"))
    table = world_results.rows(lambda _: stored, lambda name: name == "world-before")
    line, _, links = table.splitlines()[2:]
    what = world_rows.rows()["nominal"].what
    cells = f"| nominal | {what} | 1 assembled, 1 held | 0.3 (0.3) | 55 (55) | 0 |" + " - |" * 7
    assert line == cells
    assert links == "Results: [world-before](results/world-before.json)."
    assert "Not measured" in world_results.floor(lambda _: stored, lambda _: False)
    assert world_results.readme(lambda _: stored, lambda _: False) == []


def test_the_plant_floor_is_shown_against_its_bars() -> None:
    stored = world_results.condensed(raw("plant-floor", "plant-floor-harsh"))
    stored_floor = "plant-floor".__eq__
    table = world_results.floor(lambda _: stored, stored_floor)
    assert "[12 ms](results/plant-floor.json)" in table
    assert "| total error at impact, mm | 0.35 (0.8) | 0.3 (0.3) | 0.3 (0.3) |" in table
    assert "missed" in table
    labels = [label for label, *_ in world_results.readme(lambda _: stored, stored_floor)]
    assert labels == ["a plant floor, 2 objects, 12 ms", "a harsh one, 2 objects, 12 ms"]


def test_the_second_station_is_shown_against_its_bar() -> None:
    stored = world_results.condensed(raw("mujoco"))
    assert "| total error at impact, mm | 0.5 | 0.3 (0.3) |" in world_results.second(
        lambda _: stored
    )


def test_every_size_of_the_page_is_read_from_both_scenarios() -> None:
    lines = world_results.sizes().splitlines()[2:]
    assert len(lines) == len(world_results.SIZES)
    assert any(line.startswith("| range bias | 2 mm/m | 3 mm/m |") for line in lines)


def test_an_identified_row_is_shown_against_its_bars() -> None:
    stored = {
        "world": world_results.condensed(raw("hand-eye-2mm")),
        "world-learnt": world_results.condensed(raw("hand-eye-2mm")),
    }
    table = world_results.identified(stored.__getitem__, stored.__contains__)
    line = (
        "| [hand-eye-2mm](results/world-learnt.json) | 0..1 | 1 assembled, 1 held | 0.3 (0.3)"
        " | 0.2 (0.2) | 0.3 (0.3) | | 0.49 | 55 (55) | 0 |"
    )
    assert table.splitlines()[2:] == [line.replace("| |", "|  |")]
