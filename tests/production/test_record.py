"""Quality records: bounded, plain, and with a row for the table."""

import json
from typing import Any

import numpy as np
from cell import World, parameters
from msgspec.structs import replace

from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.tracking.touch.tare import Tare
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.production.object_queue import AnnouncedPart
from linemate.daemon.production.record import COLUMNS, COURSE, MOST_EVENTS, PartRecord, missed, row

PART = AnnouncedPart("P1", "sedan", 0.0)


class Recorded(World):
    """A world that keeps the inputs of its last step."""

    given: Inputs

    def inputs(self, order: MotionOrder = MotionOrder.HOLD, **changes: Any) -> Inputs:
        self.given = super().inputs(order, **changes)
        return self.given


def entries(count: int) -> list[LogEntry]:
    """Steps of a robot that tracks its object."""
    world, found = Recorded(parameters()), []
    for k in range(count):
        outputs = world.step(MotionOrder.TRACK if k > 100 else MotionOrder.HOLD, start=k == 101)
        state = "track" if k > 100 else "idle"
        found.append(LogEntry(k, state, world.given, outputs, None, world.state, parameters()))
    return found


def finished(record: PartRecord, stamp_ns: int) -> dict[str, Any]:
    return record.finish(stamp_ns, is_good=True, reason="", replies_lost=2, recording="a.mcap")


def test_a_record_has_the_first_time_of_each_state_and_the_estimates() -> None:
    steps = entries(300)
    record = PartRecord(PART, steps[0].inputs.stamp_ns, "2026-11-23T08:00:00Z", "left")
    for entry in steps:
        record.add(entry)
    plain = finished(record, steps[-1].inputs.stamp_ns)
    assert plain["times_s"]["idle"] == 0.0
    assert plain["times_s"]["track"] == round(101 * 0.012, 3)
    assert record.seen
    assert 0.0 < plain["estimates"]["sigma_mm"] < 2.0
    assert plain["force"]["impact_n"] is None  # no contact yet
    assert plain["missing"] == 0
    json.dumps(plain, allow_nan=False)


def test_a_record_stays_bounded_however_long_a_part_takes() -> None:
    (step,) = entries(1)
    outputs = replace(step.outputs, contact=True, events=(("stop", "confirmed"),) * 3)
    record = PartRecord(PART, 0, "2026-11-23T08:00:00Z", "left")
    for k in range(5000):
        inputs = replace(step.inputs, stamp_ns=k * 12_000_000)
        record.add(replace(step, inputs=inputs, outputs=outputs, counter=None))
    plain = finished(record, 60_000_000_000)
    assert len(plain["classes"]) == MOST_EVENTS
    assert len(plain["force"]["course_n"]) == COURSE
    assert plain["missing"] == 5000
    assert len(json.dumps(plain)) < 8192


def test_the_weight_of_the_tool_is_no_force_of_the_touch() -> None:
    (step,) = entries(1)
    assert step.after is not None
    tracker = replace(step.after.tracker, tare=Tare(empty=np.array((0.0, -60.0, 0.0))))
    wrench = tuple(replace(each, force=(0.0, -60.0, -25.0)) for each in step.inputs.wrench)
    touching = replace(
        step,
        inputs=replace(step.inputs, wrench=wrench),
        outputs=replace(step.outputs, contact=True),
        after=replace(step.after, tracker=tracker),
    )
    record = PartRecord(PART, 0, "2026-11-23T08:00:00Z", "left")
    record.add(touching)
    force = finished(record, 10**9)["force"]
    assert (force["impact_n"], force["largest_n"], force["course_n"]) == (25.0, 25.0, [25.0])


def test_a_change_is_timed_from_tentative_to_confirmed() -> None:
    (step,) = entries(1)
    record = PartRecord(PART, 0, "2026-11-23T08:00:00Z", "left")
    story = {10: ("stop", "tentative"), 20: ("stop", "cancelled"), 30: ("stop", "tentative")}
    story |= {45: ("stop", "confirmed"), 60: ("start", "confirmed")}
    for k in range(100):
        inputs = replace(step.inputs, stamp_ns=k * 10_000_000)
        events = (story[k],) if k in story else ()
        record.add(replace(step, inputs=inputs, outputs=replace(step.outputs, events=events)))
    assert finished(record, 10**9)["latencies_s"] == [
        {"event": "stop", "tentative_s": 0.15},
        {"event": "start", "tentative_s": 0.0},
    ]


def test_a_part_that_was_never_begun_has_a_record_and_a_row() -> None:
    plain = missed(PART, "2026-11-23T08:00:00Z", "left", "on hold")
    values = dict(zip(COLUMNS, row(plain), strict=True))
    assert (values["part"], values["ok"], values["reason"]) == ("P1", False, "on hold")
    assert values["impact_n"] is None
