"""The gate's commands to the last bit, in long random journeys to the edges of its limits.

Only additions, multiplications and square roots are made, which every machine rounds alike.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
import pytest
from transcripts import Chance, Transcript

from linemate.daemon.core.control import command_limiter as limiter
from linemate.daemon.core.control.axis_limits import Limits
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.horizon import Array

THREE_AXES = Limits(
    np.array((-1.0, -0.5, 0.0)),
    np.array((1.0, 0.5, 3.0)),
    np.array((1.0, 3.0, 0.2)),
    np.array((4.0, 60.0, 1.0)),
    np.array((40.0, 20000.0, 10.0)),
    ("slow", "quick", "soft"),
    0.012,
)
GENTLE = Limits(
    THREE_AXES.lower,
    THREE_AXES.upper,
    THREE_AXES.speed,
    0.3 * THREE_AXES.acceleration,
    0.2 * THREE_AXES.jerk,
    THREE_AXES.names,
    0.012,
)


def at(bounds: Limits, period: float) -> Limits:
    """Return the limits for commands that are another period apart."""
    return replace(bounds, period=period)


START = np.array((0.0, 0.1, 1.5))
AIMS = ((-1.3, 1.3), (-0.7, 0.7), (-0.5, 3.5))
WILD = (float("nan"), float("inf"), 1e99, 1e100, -1e101)


def _wishes(chance: Chance, period: float) -> Iterator[Array]:
    """Steps, ramps, swings, trembling and nonsense, one after another."""
    wish = START.copy()
    while True:
        kind = int(chance.between(0, 7))
        aim = np.array(
            [chance.between(-1.3, 1.3), chance.between(-0.7, 0.7), chance.between(-0.5, 3.5)]
        )
        pace = chance.between(0.02, 1.3) * THREE_AXES.speed * period
        first = wish.copy()
        for n in range(1, int(chance.between(5, 70))):
            match kind:
                case 0:
                    wish = aim.copy()
                case 1 | 2:
                    wish = wish + np.clip(aim - wish, -pace, pace)
                case 3:
                    wish = first + 0.5 * pace * n * n * period * np.sign(aim - first)
                case 4:
                    wish = first + pace * (n % 3 - 1)
                case 5:
                    wish = first.copy()
                case _:
                    wish = wish + np.clip(aim - wish, -0.1 * pace, 0.1 * pace)
            yield wish
        if chance.happens(0.1):
            spoilt = wish.copy()
            spoilt[int(chance.between(0, 3))] = chance.pick(WILD)
            yield spoilt


def _journey(chance: Chance, period: float, outcome: Transcript) -> None:
    state = limiter.at_rest(START)
    wishes = _wishes(chance, period)
    braking, gentle = 0, None
    for _ in range(400):
        if braking:
            braking -= 1
            state = limiter.brake(state, at(THREE_AXES, period), gentle and at(gentle, period))
            why = "brake"
        else:
            state, why = limiter.admit(state, next(wishes), at(THREE_AXES, period))
            if chance.happens(0.01):
                braking = int(chance.between(3, 150))
                gentle = chance.pick((None, GENTLE))
        outcome.say(why, limiter.is_standing(state), _bits(state))


def _bits(state: LimiterState) -> list[str]:
    parts = (state.position, state.speed, state.acceleration, state.desired, state.desired_speed)
    return [value.hex() for part in parts for value in part.tolist()]


@pytest.mark.parametrize(
    ("period", "digest"), [(0.012, "c21c35386129a61e"), (0.004, "8efdb339b7b94323")]
)
def test_the_gate_admits_to_the_bit_what_it_always_did(period: float, digest: str) -> None:
    outcome = Transcript()
    for journey in range(10):
        _journey(Chance(f"gate/{journey}"), period, outcome)
    assert outcome.digest == digest


@pytest.mark.parametrize(
    ("speed", "acceleration", "stands"),
    [(9.9e-5, 0.0, True), (1e-4, 0.0, False), (0.0, 9.9e-3, True), (0.0, 1e-2, False)],
)
def test_what_counts_as_standing(speed: float, acceleration: float, stands: bool) -> None:
    for axis in range(3):
        moving = np.zeros((2, 3))
        moving[:, axis] = speed, acceleration
        state = LimiterState(START, moving[0], moving[1], START, np.zeros(3))
        assert limiter.is_standing(state) is stands
