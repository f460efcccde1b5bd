"""The judge on synthetic rows, whose result is known beforehand."""

import json
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from linemate.simulators.devices.limit_judge import AxisLimit
from linemate.simulators.judge import judge as judging
from linemate.simulators.judge import table
from linemate.simulators.judge.judge import RunEvidence, StateChange, Telegrams, judge
from linemate.simulators.judge.rows import CLAMPED, FREE, PHASES, STATES, DaemonEvent, Rows, empty
from linemate.simulators.plants.scenario import Scenario

CYCLE = 0.012
EVENTS = Scenario().events
LIMITS = (AxisLimit(-3.0, 3.0, 1.0, 10.0, 1000.0),) * 7
FRESH = np.ones(2000, np.bool_)
TELEGRAMS = Telegrams(sent=1500, answered=1500, late=0, lost=0, refused=0)
IMPACT, RELEASE, FIXED, RELEASED = 6.0, 15.0, 9.5, 14.8


def perfect_run() -> Rows:
    """A run without any error: the tool meets the hub at 6 s and leaves it at 15 s."""
    rows = empty(1500)
    rows.t[:] = np.arange(1500) * CYCLE
    t = rows.t
    rows.hub[:] = (2.2, 0.0, 1.1, 1.0, 0.0, 0.0, 0.0)
    rows.hub[:, 1] = 0.1 * t
    gap = np.maximum(0.0, np.maximum(0.2 * (IMPACT - t), 0.3 * (t - RELEASE)))
    rows.sensed[:] = rows.hub
    rows.sensed[:, 0] -= gap
    for column in (rows.tcp, rows.tcp_rigid, rows.target):
        column[:] = rows.sensed
    rows.part[:] = rows.hub
    rows.contact[(t >= IMPACT) & (t < RELEASE)] = CLAMPED
    rows.digital_in[t >= FIXED] |= 1
    rows.digital_in[t >= RELEASED] |= 2
    rows.setpoints[:] = 0.0
    rows.force[:] = 0.0
    rows.answered[:] = True
    rows.state[:] = STATES.index("track")
    rows.phase[t >= RELEASE] = PHASES.index("retreat")
    return rows


def evidence(rows: Rows, **changes: Any) -> RunEvidence:
    whole = RunEvidence(rows, "wheel", 0, CYCLE, EVENTS, TELEGRAMS, LIMITS)
    return replace(whole, **changes)


def events_of(*events: tuple[float, str, str]) -> tuple[DaemonEvent, ...]:
    return tuple(DaemonEvent(*event) for event in events)


def test_a_run_without_error_is_assembled_within_limits() -> None:
    result = judge(evidence(perfect_run()))
    assert (result["assembled"], result["outcome"]) == (True, "assembled")
    assert result["within_limits"] is True
    assert result["impact_s"] == pytest.approx(IMPACT)
    for error in ("control", "plan", "prediction", "total"):
        for window in ("approach", "stop", "impact", "contact", "restart"):
            assert result[f"{error}_error"][window]["max_mm"] < 1e-9
    json.dumps(result, allow_nan=False)


def test_each_error_shows_in_its_own_figure_and_in_the_total() -> None:
    shifts = {
        "control": ("tcp", "tcp_rigid"),
        "plan": ("tcp", "tcp_rigid", "target"),
        "prediction": ("tcp", "tcp_rigid", "target", "sensed", "part"),
    }
    for name, columns in shifts.items():
        rows = perfect_run()
        for column in columns:
            getattr(rows, column)[:, 2] += 0.002
        result = judge(evidence(rows))
        for error in ("control", "plan", "prediction"):
            expected = 2.0 if error == name else 0.0
            assert result[f"{error}_error"]["approach"]["max_mm"] == pytest.approx(expected)
        assert result["total_error"]["approach"]["rms_mm"] == pytest.approx(2.0)


def test_a_turn_is_reported_in_milliradians() -> None:
    rows = perfect_run()
    for column in (rows.tcp, rows.tcp_rigid):
        column[:, 3:] = (np.cos(0.0015), 0.0, np.sin(0.0015), 0.0)
    result = judge(evidence(rows))
    assert result["control_error"]["contact"]["max_mrad"] == pytest.approx(3.0)
    assert result["within_limits"] is False


def test_the_elastic_tcp_counts_in_free_space_and_the_rigid_one_in_contact() -> None:
    rows = perfect_run()
    rows.tcp[:, 0] += 0.001
    rows.tcp_rigid[:, 0] += 0.003
    result = judge(evidence(rows))["control_error"]
    assert result["approach"]["max_mm"] == pytest.approx(1.0)
    assert result["impact"]["max_mm"] == pytest.approx(1.0)
    assert result["contact"]["max_mm"] == pytest.approx(3.0)


@pytest.mark.parametrize(
    ("at", "windows"),
    [
        (4.9, set()),
        (5.1, {"approach", "stop"}),
        (5.995, {"approach", "stop", "impact"}),
        (6.2, {"stop", "contact"}),
        (7.0, {"contact"}),
        (8.9, {"contact"}),
        (9.05, {"contact", "restart"}),
        (9.5, {"restart"}),
        (11.2, {"contact"}),
        (15.1, set()),
    ],
)
def test_a_spike_shows_in_the_windows_it_falls_in(at: float, windows: set[str]) -> None:
    rows = perfect_run()
    row = int(at / CYCLE + 1e-9)
    rows.tcp[row, 2] += 0.004
    rows.tcp_rigid[row, 2] += 0.004
    found = judge(evidence(rows))["total_error"]
    hit = {name for name in found if found[name] and found[name]["max_mm"] > 3.9}
    assert hit - {"quiet"} == windows


def test_without_contact_there_is_nothing_to_say_of_contact() -> None:
    rows = perfect_run()
    rows.contact[:] = FREE
    result = judge(evidence(rows))
    assert result["control_error"]["contact"] is None
    assert result["control_error"]["approach"] is None
    assert result["impact_s"] is None
    assert result["outcome"] != "assembled"


def test_the_outcome_is_the_emulators_word() -> None:
    rows = perfect_run()
    assert judge(evidence(rows, collision="tool hit the hub"))["outcome"] == "collision"
    assert judge(evidence(rows, broken="KSS29002"))["outcome"] == "fault"
    unscrewed = perfect_run()
    unscrewed.digital_in[:] = 0
    assert judge(evidence(unscrewed))["outcome"] == "retreated"
    stuck = perfect_run()
    stuck.digital_in[:] = 0
    stuck.contact[:] = FREE
    stuck.phase[:] = 0
    assert judge(evidence(stuck))["outcome"] == "held"
    latched = perfect_run()
    latched.state[-1] = STATES.index("fault")
    assert judge(evidence(latched))["outcome"] == "fault"
    near = perfect_run()
    near.tcp[-1] = near.hub[-1]
    assert judge(evidence(near))["outcome"] != "assembled"


@pytest.mark.parametrize(
    ("unanswered", "tolerated", "strict", "is_within"),
    [
        (0, 100, True, True),
        (1, 100, False, True),
        (100, 100, False, True),
        (101, 100, False, False),
        (1, 100, True, False),
        (5000, None, False, True),
    ],
)
def test_late_replies_count_from_where_the_controller_does_not_tolerate_them(
    unanswered: int, tolerated: int | None, strict: bool, is_within: bool
) -> None:
    lost = unanswered // 2
    counts = replace(TELEGRAMS, lost=lost, late=unanswered - lost)
    run = evidence(perfect_run(), telegrams=counts, tolerated=tolerated)
    result = judge(run, strict=strict)
    assert (result["assembled"], result["within_limits"]) == (True, is_within)
    limit = 0 if strict else tolerated
    expected = [f"{unanswered} telegrams without a good reply in time, limit {limit}"]
    assert result["shortfalls"] == ([] if is_within else expected)
    assert result["telegrams"]["tolerated"] == limit


def test_whatever_is_not_within_limits_is_named_with_its_value_and_limit() -> None:
    rows = perfect_run()
    rows.target[:, 2] += 0.0012
    rows.setpoints[700, 0] = 2.0
    result = judge(evidence(rows, limits=LIMITS))
    assert (result["assembled"], result["within_limits"]) == (True, False)
    named = " / ".join(result["shortfalls"])
    assert "control error in approach 1.20 mm, limit 1 mm" in named
    assert f"{result['limits']['violations']} setpoints beyond the axis limits, limit 0" in named
    text = table.outcome_line(result)
    assert "NOT within limits: control error in approach 1.20 mm, limit 1 mm" in text
    assert "0 violations" not in text


def test_a_result_says_not_within_limits_only_with_what_is_not() -> None:
    for counts in (TELEGRAMS, replace(TELEGRAMS, late=3), replace(TELEGRAMS, late=300)):
        result = judge(evidence(perfect_run(), telegrams=counts))
        text = table.outcome_line(result)
        assert ("NOT within limits: " in text) is (counts.late == 300)
        assert f"replies: {counts.late} late (100 tolerated)" in text


STALE = "no fresh position: camera silent for 0.31 s, distance 0.02 s (limit 0.30 s)"


@pytest.mark.parametrize(
    ("outcome", "changes", "reason"),
    [
        ("held", ["armed -> track: started", f"track -> hold: {STALE}"], f"track -> hold: {STALE}"),
        (
            "held",
            ["track -> hold: a", "hold -> track: started again", "track -> hold: b"],
            "track -> hold: b",
        ),
        (
            "held",
            ["init -> idle: x", "armed -> track: started"],
            "the run ended in track, entered by: armed -> track: started",
        ),
        ("held", [], "the daemon's state never changed. Check the robot link."),
        (
            "retreated",
            ["track -> contact: c", "contact -> retreat: overload", "retreat -> idle: retreated"],
            "contact -> retreat: overload",
        ),
        ("fault", ["track -> fault: link", "fault -> idle: acknowledged"], "track -> fault: link"),
        (
            "fault",
            ["track -> hold: missing", "hold -> fault: lost"],
            "track -> hold: missing; hold -> fault: lost",
        ),
    ],
)
def test_what_is_not_assembled_has_its_reason_in_the_words_of_the_state_table(
    outcome: str, changes: list[str], reason: str
) -> None:
    rows = perfect_run()
    if outcome == "retreated":
        rows.digital_in[:] = 0
    else:
        rows.contact[:], rows.phase[:], rows.digital_in[:] = FREE, 0, 0
    if outcome == "fault":
        rows.state[-1] = STATES.index("fault")
    parsed = [StateChange(*re.fullmatch(r"(\w+) -> (\w+): (.*)", c).groups()) for c in changes]  # type: ignore[union-attr]
    result = judge(evidence(rows, changes=parsed))
    assert (result["outcome"], result["reason"]) == (outcome, reason)


def test_a_run_that_never_started_says_why_its_order_was_refused() -> None:
    rows = perfect_run()
    rows.contact[:], rows.phase[:], rows.digital_in[:] = FREE, 0, 0
    idle, started = StateChange("init", "idle", "x"), StateChange("armed", "track", "started")
    refusal = "arm refused: no fresh force"
    never = judge(evidence(rows, changes=[idle], refusal=refusal))
    assert never["reason"] == "never started: arm refused: no fresh force"
    later = judge(evidence(rows, changes=[idle, started], refusal=refusal))
    assert later["reason"].startswith("the run ended in track")


def test_only_what_is_assembled_has_no_reason() -> None:
    changes = [StateChange("contact", "retreat", "the task retreats")]
    assert judge(evidence(perfect_run(), changes=changes))["reason"] is None
    hit = judge(evidence(perfect_run(), changes=changes, collision="missed the hub"))
    assert hit["reason"] == "missed the hub; contact -> retreat: the task retreats"
    broken = judge(evidence(perfect_run(), broken="KSS29002"))
    assert (broken["outcome"], broken["reason"]) == ("fault", "KSS29002")


def test_latencies_run_from_the_true_onset() -> None:
    events = events_of(
        (5.16, "stop", "tentative"), (5.28, "stop", "confirmed"),
        (10.5, "start", "tentative"), (10.8, "start", "confirmed"),
    )  # fmt: skip
    stop, start = judge(evidence(replace(perfect_run(), events=events)))["detection"]
    assert (stop["event"], stop["perceived_s"], stop["confirmed_s"]) == ("stop", 0.16, 0.28)
    assert (start["event"], start["perceived_s"], start["confirmed_s"]) == ("start", 1.5, 1.8)


def test_what_a_run_did_not_live_to_see_was_not_missed() -> None:
    result = judge(evidence(perfect_run().cut(600)))
    assert [entry["event"] for entry in result["detection"]] == ["stop"]


def test_a_perception_that_was_taken_back_is_not_the_perception() -> None:
    events = events_of(
        (5.1, "stop", "tentative"), (5.12, "stop", "cancelled"),
        (5.2, "stop", "tentative"), (5.3, "stop", "confirmed"),
    )  # fmt: skip
    found, alarms = judging.detections(events, EVENTS)
    assert (found[0]["perceived_s"], found[0]["confirmed_s"]) == (0.2, 0.3)
    assert (found[1]["perceived_s"], found[1]["confirmed_s"]) == (None, None)
    assert alarms == {"tentative": 0, "confirmed": 0}


def test_what_is_reported_without_reason_is_a_false_alarm() -> None:
    events = events_of(
        (2.0, "stop", "tentative"), (2.1, "stop", "cancelled"), (3.0, "start", "tentative"),
        (5.2, "start", "tentative"), (5.3, "stop", "confirmed"), (8.0, "start", "confirmed"),
    )  # fmt: skip
    found, alarms = judging.detections(events, EVENTS)
    assert alarms == {"tentative": 3, "confirmed": 1}
    assert found[0]["perceived_s"] == found[0]["confirmed_s"] == pytest.approx(0.3)


def test_setpoints_within_limits_are_no_violation_even_as_rounded_on_the_wire() -> None:
    t = np.arange(2000) * 0.002
    # Speed 1 and acceleration 10, both at their limits, jerk 200.
    q = np.tile(0.025 * (20.0 * t - np.sin(20.0 * t)), (7, 1)).T
    rounded = np.radians(np.round(np.degrees(q), 8))
    assert judging.violations(rounded, FRESH, LIMITS, 0.002)["violations"] == 0


@pytest.mark.parametrize(
    ("limit", "what"),
    [
        (AxisLimit(-0.05, 3.0, 9.0, 99.0, 999.0), "position"),
        (AxisLimit(-3.0, 3.0, 0.9, 99.0, 999.0), "speed"),
        (AxisLimit(-3.0, 3.0, 9.0, 9.0, 999.0), "acceleration"),
        (AxisLimit(-3.0, 3.0, 9.0, 99.0, 90.0), "jerk"),
    ],
)
def test_each_limit_is_guarded(limit: AxisLimit, what: str) -> None:
    t = np.arange(2000) * 0.004
    q = np.tile(0.1 * np.sin(10.0 * t), (7, 1)).T
    found = judging.violations(q, FRESH, (limit,) * 7, 0.004)
    assert found["violations"] > 0, what
    if what != "position":
        assert found["worst_share"][what] > 1.0


def test_the_controllers_own_halt_is_no_ones_violation_but_the_jump_after_it_is() -> None:
    q = np.zeros((2000, 7))
    q[:1000] = 0.9 * 0.004 * np.arange(1000)[:, None]
    q[:1000] -= q[999]
    limits = (AxisLimit(-9.0, 9.0, 1.0, 1e9, 1e9),) * 7
    held = FRESH.copy()
    held[1000:1010] = False
    assert judging.violations(q, held, limits, 0.004)["violations"] == 0
    q[1010:] += 0.005
    assert judging.violations(q, held, limits, 0.004)["violations"] == 7


def test_contact_force_is_reported_in_newtons() -> None:
    rows = perfect_run()
    rows.force[:] = (3.0, 0.0, 4.0)
    assert judge(evidence(rows))["contact_force_n"] == {"max": 5.0, "rms": 5.0}


def test_virtual_time_has_no_computing_time() -> None:
    assert judge(evidence(perfect_run()))["step_us"] == {"p50": None, "p99": None, "max": None}
