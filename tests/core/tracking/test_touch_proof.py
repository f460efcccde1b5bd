"""Proof of a touch: a force that is more than the tool's advance gives."""

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.core.tracking.touch import touch_proof

DT, STIFFNESS = 0.012, 50e3


def doubted_after(rate: float, advance: float, begun: float = 0.0) -> float | None:
    """Time at which a force that drifts from the touch on is doubted [s].

    Args:
        rate: of the drift [N/s].
        advance: of the tool beyond the touch [m].
        begun: time since the touch as the drift begins [s].
    """
    beyond_s = 0.0
    for k in range(100):
        push = STIFFNESS * advance + rate * max(k * DT - begun, 0.0)
        beyond_s = touch_proof.advanced(beyond_s, push, advance, STIFFNESS, k * DT, DT)
        if touch_proof.is_doubted(beyond_s):
            return k * DT
    return None


@pytest.mark.parametrize("rate", [500.0, 800.0, 2000.0])
def test_a_force_that_drifts_on_after_the_touch_is_doubted(rate: float) -> None:
    at_s = doubted_after(rate, 0.001)
    assert at_s is not None
    assert at_s < 0.3


def test_a_tool_that_ran_far_into_the_object_is_not_doubted() -> None:
    assert doubted_after(0.0, 0.004) is None


@pytest.mark.parametrize(("quicker", "doubted"), [(0.0, True), (0.0012, False), (-0.001, True)])
def test_a_robot_that_is_ahead_of_its_plan_presses_by_that_more(
    quicker: float, *, doubted: bool
) -> None:
    planned = np.array((0.3, 0.1, 2.0, 0.0, 0.5, 0.0))
    tcp = planned.copy()
    tcp[:3] += quicker * rotations.exp(planned[3:])[:, 2]
    beyond_s, push = 0.0, 190.0
    for k in range(20):
        advance = touch_proof.advance(0.001, tcp, planned)
        beyond_s = touch_proof.advanced(beyond_s, push, advance, STIFFNESS, k * DT, DT)
    assert touch_proof.is_doubted(beyond_s) is doubted


def test_a_touch_that_was_proved_is_not_doubted_later() -> None:
    assert doubted_after(2000.0, 0.001, begun=touch_proof.PROVEN_S) is None


def test_one_force_beyond_the_advance_is_not_doubted_and_a_doubted_touch_stays_so() -> None:
    once = touch_proof.advanced(0.0, 300.0, 0.001, STIFFNESS, 0.2, DT)
    assert not touch_proof.is_doubted(once)
    assert touch_proof.advanced(once, 50.0, 0.001, STIFFNESS, 0.2, DT) == 0.0
    doubted = touch_proof.DOUBTED_S
    assert touch_proof.advanced(doubted, 0.0, 0.001, STIFFNESS, 1.0, DT) == doubted
