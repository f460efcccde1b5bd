"""Order of a task's phases, and the gates without which the tool tears or drops the part.

Invariants:
- Pure. A task without contact needs none of these gates.
"""

from collections.abc import Iterator
from itertools import pairwise

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core.tracking.task import Gate, Phase, TaskFile

_RANKS = {
    Phase.WAIT: 0,
    Phase.APPROACH: 0,
    Phase.CONTACT: 1,
    Phase.SCREWS: 1,
    Phase.RETREAT: 2,
    Phase.DONE: 3,
}


def disordered(task: TaskFile) -> Iterator[Complaint]:
    """Return phases that go back, and the gates that are missing behind the contact."""
    points = task.waypoints
    for i, (before, point) in enumerate(pairwise(points), start=1):
        if _RANKS[point.phase] < _RANKS[before.phase]:
            what = (
                f"{point.phase} cannot follow {before.phase}: the order is wait or approach, "
                "contact or screws, retreat, done. A waypoint without a phase has approach."
            )
            yield Complaint(("waypoints", i, "phase"), what)
    phases = [point.phase for point in points]
    if Phase.CONTACT not in phases and Phase.SCREWS not in phases:
        return
    yield from _torn(task)
    yield from _dropped(task, phases)


def _torn(task: TaskFile) -> Iterator[Complaint]:
    """Return the waypoint from which the tool withdraws without a gate on the open clamp."""
    for i, point in enumerate(task.waypoints):
        if point.gate is Gate.WHEEL_RELEASED:
            return
        if _RANKS[point.phase] > _RANKS[Phase.CONTACT]:
            what = (
                "the tool withdraws from here, and no waypoint up to it waits for the open clamp: "
                "a closed one would be torn off the object. Set gate: wheel_released, and "
                "tool.released_after for a tool without that signal."
            )
            yield Complaint(("waypoints", i, "gate"), what)
            return


def _dropped(task: TaskFile, phases: list[Phase]) -> Iterator[Complaint]:
    """Return the order to open the clamp if it does not wait for the screws."""
    release = task.tool.release_wheel
    waits = any(
        point.gate is Gate.SCREWS_FIXED and point.time <= release for point in task.waypoints
    )
    if Phase.SCREWS in phases and not waits:
        what = (
            f"no waypoint up to {release:g} s waits for the screws: the clamp would open with "
            "loose ones. Set gate: screws_fixed behind the phase screws, and tool.fixed_after for "
            "a tool without that signal."
        )
        yield Complaint(("tool", "release_wheel"), what)
