"""Share of the damping over the horizon."""

from functools import cache

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core import parameters
from linemate.daemon.core.tracking.damping import FREED_S, horizon_shares
from linemate.daemon.core.tracking.goal.rest_state import at_rest
from linemate.daemon.core.tracking.tracker_state import Tracker
from linemate.simulators.harness import setup


@cache
def compiled() -> Tracker:
    cell = setup.make("wheel")
    return parameters.build(cell.task, cell.urdf, cell.tracking, cell.control, 0.012).tracker


def test_a_tool_that_is_withdrawn_is_damped_where_the_clock_stands_at_the_contact() -> None:
    tracker = compiled()
    clamped = replace(at_rest(tracker, np.zeros(6), 0.0), time=tracker.search_time + 1.0)
    assert not horizon_shares(tracker, clamped, clamped.time).any()
    shares = horizon_shares(tracker, replace(clamped, withdrawn=0.0), clamped.time)
    assert shares[0] == 0.0
    assert (shares[tracker.span >= FREED_S] == 1.0).all()
