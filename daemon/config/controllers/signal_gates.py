"""Gates of a task that wait for a signal of the controller."""

from collections.abc import Iterator

from linemate.daemon.core.tracking.task import Gate, TaskFile


def waiting_gates(task: TaskFile) -> Iterator[tuple[str, str]]:
    """Yield each gate that waits for a signal: what waits for what, and the key to set instead."""
    for i, waypoint in enumerate(task.waypoints):
        instead = {
            Gate.SCREWS_FIXED: ("fixed_after", task.tool.fixed_after),
            Gate.WHEEL_RELEASED: ("released_after", task.tool.released_after),
        }.get(waypoint.gate)
        if instead is not None and instead[1] is None:
            yield f"waypoints[{i}] waits for {waypoint.gate}", f"tool.{instead[0]}"
