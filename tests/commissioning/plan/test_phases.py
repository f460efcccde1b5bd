"""Phases in their order, and the gates behind the contact."""

from dataclasses import replace
from typing import Any

from cell import TASK

from linemate.daemon.commissioning.plan.phases import disordered
from linemate.daemon.config.documents import spelled
from linemate.daemon.core.tracking.task import Gate, Phase, TaskFile

LAST = len(TASK.file.waypoints) - 1


def complaints_of(file: TaskFile) -> list[str]:
    return [f"{spelled(complaint.path)}: {complaint.what}" for complaint in disordered(file)]


def with_point(number: int, **changes: Any) -> TaskFile:
    points = list(TASK.file.waypoints)
    points[number] = replace(points[number], **changes)
    return replace(TASK.file, waypoints=tuple(points))


def test_the_shipped_task_is_in_order() -> None:
    assert complaints_of(TASK.file) == []


def test_a_phase_that_was_left_out_behind_the_contact_is_reported_as_approach() -> None:
    for number in range(4, LAST + 1):
        lines = complaints_of(with_point(number, phase=Phase.APPROACH))
        assert lines[0].startswith(f"waypoints[{number}].phase: approach cannot follow ")


def test_a_retreat_that_waits_for_no_open_clamp_is_reported() -> None:
    without = (*TASK.file.waypoints[:7], *TASK.file.waypoints[8:])
    for file in (with_point(7, gate=Gate.NONE), replace(TASK.file, waypoints=without)):
        (line,) = complaints_of(file)
        assert line.startswith("waypoints[7].gate: the tool withdraws from here")
        assert "Set gate: wheel_released" in line


def test_a_clamp_that_opens_before_the_screws_are_fixed_is_reported() -> None:
    (line,) = complaints_of(with_point(5, gate=Gate.NONE))
    assert line.startswith("tool.release_wheel: no waypoint up to 14.5 s waits for the screws")
    early = replace(TASK.file, tool=replace(TASK.file.tool, release_wheel=13.0))
    assert "no waypoint up to 13 s" in complaints_of(early)[0]


def test_a_task_that_fixes_no_screws_needs_no_gate_on_them() -> None:
    points = [*TASK.file.waypoints]
    points[4] = replace(points[4], phase=Phase.CONTACT)
    points[5] = replace(points[5], gate=Gate.NONE)
    assert complaints_of(replace(TASK.file, waypoints=tuple(points))) == []
