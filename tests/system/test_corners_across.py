"""A body that a stop excites across the conveyor leaves no corner in the plan at 4 ms."""

import numpy as np

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import compute_errors, windows


def test_a_stop_that_excites_a_body_across_throws_the_plan_off_by_no_millimetre() -> None:
    made = setup.make("plant-floor", ("scenario.duration_s=6.4",), cycle_ms=4.0)
    evidence = lockstep.run(made, 4)
    plan, _ = compute_errors(evidence.rows)["plan"]
    stop = windows(evidence.rows, evidence.events)["stop"]
    # The end of the ramp is among the steps that the merge reads: 4.1 mm without rounding.
    assert np.nanmax(plan[stop]) < 0.001
