"""State table of go or no-go: every zone, order and reason."""

import itertools
import math

import pytest
from msgspec import structs

from linemate.daemon.core.tracking.go_no_go.decision import (
    BACK_S,
    CLEAR_S,
    COUNTED,
    DECIDED_S,
    GO,
    LOOK_S,
    POSITION_S,
    RELEASE_SHARE,
    TODO,
    GoEvidence,
    GoOrder,
    GoState,
    Reason,
    Zone,
    describe,
    find_reasons,
    next_state,
)
from linemate.daemon.core.tracking.task import GuardedApproach

T0 = 0.012
GUARD = GuardedApproach()
GOOD = GoEvidence(
    sight_s=0.1,
    checked_s=1.0,
    prediction=0.001,
    angle=0.002,
    distance=0.0,
    deviation=0.0003,
    angle_deviation=0.0005,
    nis=1.0,
    rejected=0,
    following=0.0001,
    tentative=False,
    steady_s=5.0,
)
BAD = {
    Reason.SIGHT: {"sight_s": GUARD.sight + 0.01},
    Reason.POSITION: {"position_s": POSITION_S + 0.01},
    Reason.UNCHECKED: {"checked_s": GUARD.checked - 0.01},
    Reason.PREDICTION: {"prediction": GUARD.tolerance + 1e-6},
    Reason.ANGLE: {"angle": GUARD.angle_tolerance + 1e-6},
    Reason.DISTANCE: {"distance": -GUARD.tolerance - 1e-6},
    Reason.COVARIANCE: {"deviation": GUARD.tolerance / 3.0 + 1e-6},
    Reason.INNOVATION: {"rejected": 4},
    Reason.FOLLOWING: {"following": GUARD.tolerance + 1e-6},
    Reason.CHANGE: {"tentative": True},
    Reason.UNSEEN: {"looked_s": LOOK_S - 0.01},
    Reason.TURN: {"turns": True},
    Reason.BOLTS: {"jams": True},
    Reason.FORCE: {"force": 30.0},
}
AT_ONCE = {Reason.UNSEEN, Reason.TURN, Reason.BOLTS}


def after(
    state: GoState, reasons: tuple[Reason, ...], zone: Zone, seconds: float, may_back: bool = True
) -> GoState:
    for _ in range(round(seconds / T0)):
        state = next_state(state, reasons, zone, T0, stands=True, may_back=may_back)
    return state


def test_good_evidence_gives_no_reason() -> None:
    assert find_reasons(GOOD, GUARD, waiting=False) == ()
    assert find_reasons(GOOD, GUARD, waiting=True) == ()


def test_a_task_that_needs_no_checked_prediction_goes_on_without() -> None:
    evidence = structs.replace(GOOD, checked_s=0.0)
    assert find_reasons(evidence, GUARD, waiting=False) == (Reason.UNCHECKED,)
    assert find_reasons(evidence, GuardedApproach(checked=0.0), waiting=False) == ()


@pytest.mark.parametrize("reason", Reason)
def test_each_reason_is_found_alone_and_named_with_its_value(reason: Reason) -> None:
    evidence = structs.replace(GOOD, **BAD[reason])
    assert find_reasons(evidence, GUARD, waiting=False) == (reason,)
    text = describe(reason, evidence, GUARD)
    assert text.endswith(TODO[reason])
    assert "nan" not in describe(reason, structs.replace(GOOD, sight_s=math.inf), GUARD)


@pytest.mark.parametrize(("along", "names_conveyor"), [(0.0005, False), (0.0010, True)])
def test_a_covariance_along_the_conveyor_is_no_fault_of_the_camera(
    along: float, *, names_conveyor: bool
) -> None:
    evidence = structs.replace(GOOD, deviation=0.0011, along=along)
    text = describe(Reason.COVARIANCE, evidence, GUARD)
    assert "three sigma at the contact 3.3 mm" in text
    assert ("along the conveyor" in text) is names_conveyor
    assert ("camera" in text) is not names_conveyor


def test_a_waiting_tool_names_the_limit_that_it_waits_for() -> None:
    evidence = structs.replace(GOOD, prediction=0.95 * GUARD.tolerance)
    assert find_reasons(evidence, GUARD, waiting=True) == (Reason.PREDICTION,)
    limit = f"limit {0.85e3 * GUARD.tolerance:.1f} mm"
    assert limit in describe(Reason.PREDICTION, evidence, GUARD, waiting=True)


@pytest.mark.parametrize(
    ("zone", "order", "reasons", "may_back"),
    list(itertools.product(Zone, GoOrder, [(), *((r,) for r in Reason)], (False, True))),
)
def test_the_whole_table_decides(
    zone: Zone, order: GoOrder, reasons: tuple[Reason, ...], may_back: bool
) -> None:
    state = (
        GO
        if order is GoOrder.GO
        else GoState(order, (Reason.ANGLE,), "no", 0.0, 2 * DECIDED_S, 1.0)
    )
    new = next_state(state, reasons, zone, T0, stands=True, may_back=may_back)
    counts = bool(set(reasons) & COUNTED[zone])
    if zone is Zone.FINAL:
        assert new.order is GoOrder.GO
    elif order is GoOrder.GO:
        backs = zone is not Zone.FAR and may_back and bool(set(reasons) & AT_ONCE)
        stops = GoOrder.BACK if backs else GoOrder.STAND
        assert new.order is (stops if counts else GoOrder.GO)
    else:
        backs = zone is not Zone.FAR and may_back and (counts or order is GoOrder.BACK)
        assert new.order is (GoOrder.BACK if backs else GoOrder.STAND)
        waited_s = 0.0 if reasons == (Reason.TURN,) else 1.0 + T0
        assert new.waited_s == pytest.approx(waited_s)
        is_clear = not counts or reasons == (Reason.UNCHECKED,)
        assert new.clear_s == pytest.approx(T0 if is_clear else 0.0)


def test_no_reason_counts_in_the_final_zone_and_every_one_before_the_far_gate() -> None:
    assert COUNTED[Zone.FINAL] == frozenset()
    assert COUNTED[Zone.FAR] == frozenset(Reason)
    hard = COUNTED[Zone.MIDDLE] & COUNTED[Zone.NEAR] & COUNTED[Zone.CLOSE] & COUNTED[Zone.LAST]
    assert hard >= {Reason.PREDICTION, Reason.ANGLE, Reason.DISTANCE, Reason.FOLLOWING}


def test_a_waiting_tool_goes_on_only_after_a_time_without_a_reason() -> None:
    state = after(GO, (Reason.PREDICTION,), Zone.FAR, 1.0)
    almost = after(state, (), Zone.FAR, CLEAR_S - 2 * T0)
    assert almost.order is GoOrder.STAND
    again = after(almost, (Reason.PREDICTION,), Zone.FAR, T0)
    assert after(again, (), Zone.FAR, CLEAR_S - 2 * T0).order is GoOrder.STAND
    assert after(again, (), Zone.FAR, CLEAR_S + 2 * T0).order is GoOrder.GO


def test_a_check_that_was_only_missing_frees_the_way_at_once() -> None:
    waiting = after(GO, (Reason.UNCHECKED,), Zone.FAR, 0.5)
    assert waiting.order is GoOrder.STAND
    assert after(waiting, (), Zone.FAR, T0).order is GoOrder.GO
    noisy = after(waiting, (Reason.UNCHECKED, Reason.PREDICTION), Zone.FAR, T0)
    noisy = after(noisy, (Reason.UNCHECKED,), Zone.FAR, 0.5 * CLEAR_S)
    assert after(noisy, (), Zone.FAR, T0).order is GoOrder.STAND
    assert after(noisy, (), Zone.FAR, CLEAR_S).order is GoOrder.GO


def test_a_waiting_tool_needs_clearly_better_values() -> None:
    evidence = structs.replace(GOOD, prediction=0.5 * (1.0 + RELEASE_SHARE) * GUARD.tolerance)
    assert find_reasons(evidence, GUARD, waiting=False) == ()
    assert find_reasons(evidence, GUARD, waiting=True) == (Reason.PREDICTION,)


def test_a_no_go_on_the_way_stands_first_and_then_backs_off() -> None:
    state = after(GO, (Reason.DISTANCE,), Zone.MIDDLE, BACK_S - 2 * T0)
    assert state.order is GoOrder.STAND
    assert after(state, (Reason.DISTANCE,), Zone.MIDDLE, 4 * T0).order is GoOrder.BACK


def test_a_change_of_class_alone_is_waited_out_until_it_is_decided() -> None:
    state = after(GO, (Reason.CHANGE,), Zone.LAST, DECIDED_S - 2 * T0)
    assert state.order is GoOrder.STAND
    assert after(state, (), Zone.LAST, CLEAR_S + 2 * T0).order is GoOrder.GO
    assert after(state, (Reason.CHANGE,), Zone.LAST, 4 * T0).order is GoOrder.BACK
    both = (Reason.DISTANCE, Reason.CHANGE)
    assert after(GO, both, Zone.LAST, BACK_S + 2 * T0).order is GoOrder.BACK


def test_a_tool_near_the_object_does_not_back_off() -> None:
    state = after(GO, (Reason.DISTANCE,), Zone.CLOSE, 3.0, may_back=False)
    assert state.order is GoOrder.STAND


def test_all_waiting_of_an_assembly_adds_up() -> None:
    state = after(GO, (Reason.ANGLE,), Zone.FAR, 1.0)
    state = after(state, (), Zone.FAR, 1.0)
    assert state.order is GoOrder.GO
    state = after(state, (Reason.ANGLE,), Zone.FAR, 1.0)
    assert state.waited_s > 2.0


def test_a_no_go_before_the_gate_is_no_waiting_yet() -> None:
    state = next_state(GO, (Reason.ANGLE,), Zone.FAR, T0, stands=False, may_back=True)
    assert state.order is GoOrder.STAND
    assert state.waited_s == 0.0


def test_a_tool_that_backs_off_does_not_turn_back_before_the_far_gate() -> None:
    state = after(GO, (Reason.DISTANCE,), Zone.MIDDLE, BACK_S + 2 * T0)
    assert state.order is GoOrder.BACK
    state = after(state, (), Zone.MIDDLE, 3 * CLEAR_S)
    assert state.order is GoOrder.BACK
    assert after(state, (), Zone.FAR, T0).order is GoOrder.GO


def test_an_unseen_change_makes_the_tool_back_off_at_once() -> None:
    assert after(GO, (Reason.UNSEEN,), Zone.CLOSE, T0).order is GoOrder.BACK
    assert after(GO, (Reason.UNSEEN,), Zone.CLOSE, T0, may_back=False).order is GoOrder.STAND
    assert after(GO, (Reason.UNSEEN,), Zone.FAR, 2.0).order is GoOrder.STAND
