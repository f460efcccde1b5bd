"""A tracking robot that has come to rest: what of its task is over, and what is not."""

import numpy as np
from cell import World, parameters
from msgspec.structs import replace

from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.tracking.goal.rest_state import at_rest

P = parameters()
# Of the programme and its clock: the next task begins as the first one did.
OVER = ("time", "started", "passed", "blended", "blend_s", "clock_stood", "carried", "go", "ramp")


def test_a_task_that_was_stopped_leaves_nothing_of_its_programme_to_the_next() -> None:
    world = World(P)
    world.run(1.2)
    world.step(MotionOrder.TRACK, start=True)
    world.run(2.4, MotionOrder.TRACK)
    before = world.state.tracker
    assert before.transverse is not None
    felt = replace(before.transverse, felt=0.001)
    stood = replace(before, clock_stood=0.5, carried=0.4, transverse=felt)
    world.state = replace(world.state, tracker=stood)
    world.run(0.8, MotionOrder.HOLD)
    assert not world.state.moving
    tracker = world.state.tracker
    fresh = at_rest(P.tracker, tracker.poses[0], 0.0)
    assert np.isfinite(stood.blend_s)
    assert tracker.transverse is not None
    assert tracker.transverse.felt is None
    assert [getattr(tracker, name) for name in OVER] == [getattr(fresh, name) for name in OVER]
