"""Tables by lag, cycle and controller: what was measured is shown, what was not is not claimed."""

from typing import Any

from docs.make import lag_results


def row(control: float) -> dict[str, Any]:
    figure = {"median": control, "worst": 2.0 * control, "n": 4, "ci95": [0.0, 1.0]}
    return {"runs": 4, "assembled": 3, lag_results.CONTROL: figure}


def test_a_row_has_medians_and_worst_runs_and_a_dash_for_what_is_missing() -> None:
    text = lag_results.by_lag(lambda _: {"84": row(0.15)}, lambda _: True)
    assert text.splitlines()[2] == "| 84 | 3 of 4 | 0.15 (0.3) | - | - | - | - |"


def test_a_cycle_until_the_touch_is_compared_with_the_one_of_4_ms() -> None:
    rows = {"4": row(0.1), "12": row(0.06)}
    text = lag_results.by_cycle(lambda _: rows, lambda _: True)
    assert text.splitlines()[3] == "| 12 | 4 | 0.06 (0.12) | - | - | 0.60 |"


def test_what_was_not_measured_says_so() -> None:
    for table in (lag_results.by_lag, lag_results.by_cycle, lag_results.by_curve):
        assert "Not measured yet" in table(lambda _: {}, lambda _: False)
    assert len(lag_results.by_family(lambda _: {}, lambda _: False).splitlines()) == 2


def test_the_curve_shows_the_law_of_a_stop_next_to_what_was_measured() -> None:
    stop = {lag_results.STOP: {"median": 1.8, "worst": 2.2}}
    text = lag_results.by_curve(lambda _: {"50": row(0.1) | stop}, lambda _: True)
    # By hand: 0.104 * 0.2^2 / 2 is 2.08 mm; 1.8 mm are 0.186 s, 50 ms of them dead time.
    assert text.splitlines()[2] == "| 50 | 0.1 (0.2) | 1.8 (2.2) | - | 2.08 | 0.136 |"
    drawn = lag_results.draw(lambda _: {"20": row(0.1) | stop, "50": row(0.1) | stop})
    assert len(drawn.axes[0].lines) == 3
