"""State of the walk: its file, and which step comes next."""

import pytest

from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import SiteState, StepName, StepOutcome, StepRecordOfSite
from linemate.daemon.identification.outcome import Estimate, Refusal, ReportLine

DONE = StepRecordOfSite(
    StepOutcome.MEASURED,
    "2026-01-01",
    walk.plain_figures(
        [
            ReportLine("camera x", "mm", 1e3, Estimate(0.1, 0.001, "18 postures"), True),
            ReportLine("camera y", "mm", 1e3, Refusal("too few")),
        ]
    ),
    "camera.yaml",
    ("a.mcap",),
    took_s=61.5,
)


def test_the_state_is_the_same_after_its_file() -> None:
    state = SiteState({StepName.CAMERA: DONE})
    assert walk.from_text(walk.as_text(state)) == state
    assert state.of(StepName.CAMERA).figures[0]["value"] == pytest.approx(100.0)
    assert state.of(StepName.CAMERA).figures[1]["refused"] == "too few"


def test_steps_come_in_their_order_and_a_skipped_one_is_not_asked_again() -> None:
    state = SiteState()
    names = []
    while (step := state.next_due()) is not None:
        names.append(step.name)
        outcome = StepOutcome.SKIPPED if step.name is StepName.FORCE else StepOutcome.MEASURED
        state = state.with_result(step.name, StepRecordOfSite(outcome))
    assert names == list(walk.BY_NAME)


def test_a_step_that_is_repeated_makes_those_due_that_build_on_it() -> None:
    state = SiteState({StepName.CAMERA: DONE, StepName.CONVEYOR: DONE, StepName.LIMITS: DONE})
    state = state.with_result(StepName.CAMERA, DONE)
    assert state.of(StepName.CONVEYOR).outcome is StepOutcome.DUE
    assert "camera was measured again" in state.of(StepName.CONVEYOR).reason
    assert state.of(StepName.LIMITS).outcome is StepOutcome.MEASURED
    assert state.missing(StepName.OBJECT) == (StepName.CONVEYOR,)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        "[" * 100_000,
        '{"version": 2, "steps": {}}',
        '{"version": 1, "steps": []}',
        '{"version": 1, "steps": {"camera": {}}}',
        '{"version": 1, "steps": {"camera": {"outcome": "measured", "overlay": "../x.yaml"}}}',
        '{"version": 1, "steps": {"camera": {"outcome": "measured", "figures": [1]}}}',
        '{"version": 1, "steps": {"camera": {"outcome": "measured", "took_s": "long"}}}',
        '{"version": 1, "steps": {"camera": {"outcome": "measured", "took_s": -1}}}',
    ],
)
def test_a_damaged_file_is_refused(text: str) -> None:
    with pytest.raises(ValueError, match=r"state|JSON|steps"):
        walk.from_text(text)


def test_a_file_of_an_earlier_version_has_no_times() -> None:
    text = '{"version": 1, "steps": {"camera": {"outcome": "measured"}}}'
    assert walk.from_text(text).of(StepName.CAMERA).took_s == 0.0


def test_a_step_of_a_later_version_is_kept_out() -> None:
    text = '{"version": 1, "steps": {"dance": {"outcome": "measured"}}}'
    assert walk.from_text(text) == SiteState()
