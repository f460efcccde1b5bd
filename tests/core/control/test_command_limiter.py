"""The last gate: whatever is desired, the commands' own differences stay within the limits."""

from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from linemate.daemon.core.control import command_limiter as limiter
from linemate.daemon.core.control.axis_limits import Limits
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.horizon import Array
from linemate.protocol.stamped_samples import AXES
from linemate.simulators.harness.setup import shipped_control

CYCLES = (0.012, 0.004)
ROWS = shipped_control().limits
SHIPPED = Limits(
    np.array([row.lower for row in ROWS]),
    np.array([row.upper for row in ROWS]),
    np.array([row.speed for row in ROWS]),
    np.array([row.acceleration for row in ROWS]),
    np.array([row.jerk for row in ROWS]),
    AXES,
    0.012,
)
# One axis of another kind each: a slow one, a nervous one, one whose jerk bites at 4 ms.
THREE_AXES = Limits(
    np.array((-1.0, -0.5, 0.0)),
    np.array((1.0, 0.5, 3.0)),
    np.array((1.0, 3.0, 0.2)),
    np.array((4.0, 60.0, 1.0)),
    np.array((40.0, 20000.0, 10.0)),
    ("slow", "quick", "soft"),
    0.012,
)
REST = {7: np.array((0.0, -1.2, 1.2, 0.0, 0.8, 0.0, 1.0)), 3: np.array((0.0, 0.1, 1.5))}


def at(bounds: Limits, period: float) -> Limits:
    """Return the limits for commands that are another period apart."""
    return replace(bounds, period=period)


@dataclass(frozen=True)
class Run:
    """Commands (n, m), and the same with three steps of rest before them."""

    commands: Array
    states: list[LimiterState]
    held: list[str | None]


def run(desired: Iterable[Array], bounds: Limits, period: float, start: Array | None = None) -> Run:
    state = limiter.at_rest(REST[len(bounds.names)] if start is None else start)
    states, held = [state], []
    for each in desired:
        state, why = limiter.admit(state, each, at(bounds, period))
        states.append(state)
        held.append(why)
    return Run(np.array([s.position for s in states]), states, held)


def assert_within(commands: Array, bounds: Limits, period: float) -> None:
    """Position, speed, acceleration and jerk, all from the commands alone."""
    assert np.isfinite(commands).all()
    assert (commands >= bounds.lower - 1e-12).all()
    assert (commands <= bounds.upper + 1e-12).all()
    rest = np.tile(commands[:1], (3, 1))
    rows = np.vstack((rest, commands))
    speed = np.diff(rows, axis=0) / period
    acceleration = np.diff(speed, axis=0) / period
    jerk = np.diff(acceleration, axis=0) / period
    # Differences of positions of some radians lose 1e-15 / T, 1e-15 / T^2, 1e-15 / T^3; the gate
    # itself lets a millionth of the acceleration limit pass as a rounding.
    grain = 8.0 * np.spacing(np.abs(rows).max())
    nib = 4e-6 * bounds.acceleration
    assert (np.abs(speed) <= bounds.speed + nib * period + grain / period).all()
    assert (np.abs(acceleration) <= bounds.acceleration + nib + grain / period**2).all()
    assert (np.abs(jerk) <= bounds.jerk + nib / period + grain / period**3).all()


wild = st.one_of(
    st.floats(allow_nan=True, allow_infinity=True),
    st.floats(-4.0, 4.0),
    st.sampled_from((np.nan, np.inf, -np.inf, 1e308, -1e308, 1e150, -1e150, 0.0, 5e-324)),
)


@st.composite
def wishes(draw: st.DrawFn, axes: int) -> list[Array]:
    """Pieces of a desired motion: values held for some steps, jumps, wanderings, nonsense."""
    rows: list[Array] = []
    for _ in range(draw(st.integers(1, 8))):
        value = np.array([draw(wild) for _ in range(axes)])
        length = draw(st.integers(1, 25))
        match draw(st.sampled_from(("hold", "ramp", "shake"))):
            case "hold":
                rows += [value] * length
            case "ramp":
                last = rows[-1] if rows else REST[axes]
                last = np.where(np.abs(last) < 10.0, last, 0.0)
                end = np.where(np.abs(value) < 10.0, value, 0.0)
                rows += [last + (end - last) * i / length for i in range(1, length + 1)]
            case _:
                rows += [value, -value] * (length // 2 + 1)
    return rows


@pytest.mark.parametrize("period", CYCLES)
@pytest.mark.parametrize("bounds", [SHIPPED, THREE_AXES], ids=["shipped", "three axes"])
@settings(max_examples=25, deadline=None)
@given(data=st.data())
def test_whatever_is_desired_the_commands_stay_within_the_limits(
    bounds: Limits, period: float, data: st.DataObject
) -> None:
    desired = data.draw(wishes(len(bounds.names)))
    assert_within(run(desired, bounds, period).commands, bounds, period)


@pytest.mark.parametrize("period", CYCLES)
@pytest.mark.parametrize("huge", [1e308, -1e308, 1e200, 1e30])
def test_huge_wishes_back_and_forth_do_not_overflow_into_the_command(
    huge: float, period: float
) -> None:
    row = np.full(3, huge)
    desired = [row, row, -row, row, row, REST[3], row, REST[3], REST[3], -row] * 3
    assert_within(run(desired, THREE_AXES, period).commands, THREE_AXES, period)


@pytest.mark.parametrize("period", CYCLES)
def test_a_wish_that_is_not_finite_brakes_and_says_so(period: float) -> None:
    moving = [REST[3] + 0.2 * period * i * np.array((1.0, 1.0, 0.5)) for i in range(60)]
    for axis, bad in enumerate((np.nan, np.inf, -np.inf)):
        row = moving[-1].copy()
        row[axis] = bad
        result = run([*moving, *[row] * 200], THREE_AXES, period)
        assert set(result.held[60:]) == {"the command was not finite"}
        assert_within(result.commands, THREE_AXES, period)
        assert limiter.is_standing(result.states[-1])


@pytest.mark.parametrize("period", CYCLES)
@pytest.mark.parametrize("bounds", [SHIPPED, THREE_AXES], ids=["shipped", "three axes"])
@settings(max_examples=8, deadline=None)
@given(data=st.data())
def test_the_brake_comes_to_rest_within_the_limits_from_wherever_the_gate_can_be(
    bounds: Limits, period: float, data: st.DataObject
) -> None:
    desired = data.draw(wishes(len(bounds.names)))
    before = run(desired, bounds, period)
    state = before.states[-1]
    # All axes at once: building up, holding and letting go of the deceleration, twice over.
    ways = bounds.speed / bounds.acceleration + 2.0 * bounds.acceleration / bounds.jerk
    steps = int(2.0 * ways.max() / period) + 40
    after = []
    for _ in range(steps):
        state = limiter.brake(state, at(bounds, period))
        after.append(state.position)
    assert limiter.is_standing(state)
    assert_within(np.vstack((before.commands, after)), bounds, period)
    for _ in range(50):
        state = limiter.brake(state, at(bounds, period))
    assert np.allclose(state.position, after[-1], atol=1e-5)


@pytest.mark.parametrize("period", CYCLES)
@settings(max_examples=8, deadline=None)
@given(share=st.floats(0.05, 0.95), cycles=st.floats(0.5, 2.0))
def test_a_smooth_wish_inside_the_limits_passes_bit_for_bit(
    period: float, share: float, cycles: float
) -> None:
    # A sine that is faded in, sized by whichever limit bites first, its fade included.
    w = 2.0 * np.pi * cycles
    span = np.minimum(REST[3] - THREE_AXES.lower, THREE_AXES.upper - REST[3])
    largest = np.minimum.reduce(
        (
            0.5 * span,
            THREE_AXES.speed / (2 * w),
            THREE_AXES.acceleration / (4 * w**2),
            THREE_AXES.jerk / (8 * w**3),
        )
    )
    t = np.arange(int(2.5 / cycles / period)) * period
    fade = np.clip(t * cycles, 0.0, 1.0)
    fade = fade**4 * (35.0 - 84.0 * fade + 70.0 * fade**2 - 20.0 * fade**3)
    ripple = 0.35 * share * np.outer(fade * np.sin(w * t), largest)
    desired = REST[3] + ripple
    result = run(desired, THREE_AXES, period)
    assert result.held == [None] * len(desired)
    assert np.array_equal(result.commands[1:], desired)


def swing(t: Array) -> Array:
    """What the setpoints do while the robot tracks: some milliradians at 0.62 Hz, and a drift."""
    way = 0.005 * np.sin(2.0 * np.pi * 0.62 * t)[:, None]
    return np.asarray(REST[7] + way + np.outer(t, (*(0.005,) * 6, 0.1)))


def caught_up(jump: float, period: float) -> tuple[Run, Array]:
    """Four seconds of a swing with a jump at one second."""
    desired = swing(np.arange(int(4.0 / period)) * period)
    desired[int(1.0 / period) :] += jump
    return run(desired, SHIPPED, period), desired


@pytest.mark.parametrize("period", CYCLES)
@pytest.mark.parametrize("jump", [0.01, 0.02, 0.3, -0.3])
def test_after_a_jump_the_arm_catches_up_and_passes_again_bit_for_bit(
    jump: float, period: float
) -> None:
    result, desired = caught_up(jump, period)
    assert_within(result.commands, SHIPPED, period)
    assert not np.array_equal(result.commands[int(1.0 / period) + 1], desired[int(1.0 / period)])
    assert np.array_equal(result.commands[-50:, :6], desired[-50:, :6])


@pytest.mark.parametrize("jump", [0.001, -0.3])
def test_after_a_jump_the_linear_axis_catches_up_too(jump: float) -> None:
    result, desired = caught_up(jump, 0.004)
    assert np.array_equal(result.commands[-50:, 6], desired[-50:, 6])


@pytest.mark.parametrize("period", CYCLES)
def test_a_robot_that_held_while_more_was_desired_catches_up_without_a_stop_in_between(
    period: float,
) -> None:
    desired = swing(np.arange(int(2.0 / period)) * period)
    begin, end = int(1.0 / period), int(1.084 / period)
    state = run(desired[:begin], SHIPPED, period, desired[0]).states[-1]
    stood = state.position
    for each in desired[begin:end]:
        state, _ = limiter.admit(limiter.held(state, stood), each, at(SHIPPED, period))
    state, speeds = limiter.held(state, stood), []
    for each in desired[end:]:
        state, _ = limiter.admit(state, each, at(SHIPPED, period))
        speeds.append(state.speed[6])
    regained = speeds[: int(0.05 / period)]
    assert min(regained[1:]) > regained[0] > 0.0
    assert np.array_equal(state.position[:6], desired[-1, :6])


@pytest.mark.parametrize("period", CYCLES)
def test_after_nonsense_the_arm_catches_up_and_passes_again(period: float) -> None:
    desired = swing(np.arange(int(4.0 / period)) * period)
    desired[100:103] = np.nan
    desired[120] = 1e308
    desired[150:160, 1] = -50.0
    result = run(desired, SHIPPED, period)
    assert_within(result.commands, SHIPPED, period)
    assert np.array_equal(result.commands[-10:, :6], desired[-10:, :6])


@pytest.mark.parametrize("period", CYCLES)
@pytest.mark.parametrize("beyond", [1e-6, 0.05, 1.0])
def test_a_robot_that_stands_beyond_a_limit_may_only_come_back(
    beyond: float, period: float
) -> None:
    start = THREE_AXES.upper + beyond
    further = run([start + 0.5] * 200, THREE_AXES, period, start)
    assert (further.commands <= start).all()
    back = run([THREE_AXES.upper - 0.2] * int(8.0 / period), THREE_AXES, period, start)
    assert (back.commands <= start).all()
    assert (back.commands[-1] < THREE_AXES.upper).all()


@pytest.mark.parametrize("period", CYCLES)
def test_at_full_speed_towards_a_limit_the_robot_stops_before_it(period: float) -> None:
    for bounds in (SHIPPED, THREE_AXES):
        for target in (bounds.lower - 0.9, bounds.upper):
            result = run([target] * int(12.0 / period), bounds, period)
            assert_within(result.commands, bounds, period)
            end = np.clip(target, bounds.lower, bounds.upper)
            # It gets there, and not merely somewhere on the way.
            assert np.allclose(result.commands[-1], end, atol=2e-3)


def test_the_reason_names_the_axes_that_were_held_back() -> None:
    wish = REST[3] + np.array((0.0, 0.5, 0.0))
    assert run([wish], THREE_AXES, 0.012).held == ["limited: quick"]
    assert run([wish + 0.5], THREE_AXES, 0.012).held == ["limited: slow, quick, soft"]


@example(0.5)
@settings(max_examples=20, deadline=None)
@given(st.floats(-0.9, 0.9))
def test_a_gate_at_rest_stays_where_it_is(place: float) -> None:
    start = np.array((place, 0.5 * place, 1.0 + place))
    result = run([start] * 20, THREE_AXES, 0.012, start)
    assert (result.commands == start).all()
    assert result.held == [None] * 20
    assert limiter.is_standing(limiter.brake(result.states[-1], at(THREE_AXES, 0.012)))


def test_moving_is_not_standing() -> None:
    rest = limiter.at_rest(REST[3])
    assert limiter.is_standing(rest)
    creeping = LimiterState(REST[3], np.full(3, 2e-4), rest.acceleration, REST[3], rest.speed)
    turning = LimiterState(REST[3], rest.speed, np.full(3, 0.02), REST[3], rest.speed)
    assert not limiter.is_standing(creeping)
    assert not limiter.is_standing(turning)


GENTLE = Limits(
    THREE_AXES.lower,
    THREE_AXES.upper,
    THREE_AXES.speed,
    0.25 * THREE_AXES.acceleration,
    0.25 * THREE_AXES.jerk,
    THREE_AXES.names,
    0.012,
)


@pytest.mark.parametrize("period", CYCLES)
def test_a_gentle_stop_stays_gentle_and_comes_to_rest(period: float) -> None:
    times = period * np.arange(1, int(1.5 / period))[:, None]
    before = run(
        REST[3] + 0.1 * THREE_AXES.speed * np.maximum(0.0, times - 0.8), THREE_AXES, period
    )
    state = before.states[-1]
    assert (state.speed > 0.09 * THREE_AXES.speed).all()
    after = []
    for _ in range(int(6.0 / period)):
        state = limiter.brake(state, at(THREE_AXES, period), at(GENTLE, period))
        after.append(state)
    assert limiter.is_standing(state)
    assert_within(np.vstack((before.commands, [s.position for s in after])), THREE_AXES, period)
    taken = np.array([s.acceleration for s in after])
    # Once what the motion itself had is let go, no more than the gentle deceleration is used.
    ripe = int(0.3 / period)
    assert (np.abs(taken[ripe:]) <= GENTLE.acceleration * (1.0 + 1e-9) + 1e-9).all()
    jerk = np.abs(np.diff(taken[ripe:], axis=0)) / period
    assert (jerk <= GENTLE.jerk * (1.0 + 1e-9) + 1e-6).all()


def stopping_way(state: LimiterState, period: float, gentle: Limits | None) -> Array:
    """Return how far the axes still go (m,); the commands of the stop are within the limits."""
    commands = [state.position - state.speed * period * i for i in (3, 2, 1, 0)]
    for _ in range(int(6.0 / period)):
        state = limiter.brake(state, at(THREE_AXES, period), gentle and at(gentle, period))
        commands.append(state.position)
    assert limiter.is_standing(state)
    jumps = np.diff(np.diff(np.array(commands), axis=0), axis=0) / period**2
    assert (np.abs(jumps) <= THREE_AXES.acceleration * (1.0 + 1e-6) + 1e-6).all()
    return state.position - commands[3]


@pytest.mark.parametrize("period", CYCLES)
def test_a_gentle_stop_does_not_begin_at_the_speed_of_a_catch_up(period: float) -> None:
    planned, here = 0.1 * THREE_AXES.speed, REST[3]
    caught_up = LimiterState(here, 3.0 * planned, 0.0 * planned, here, planned)
    steady = LimiterState(here, planned, 0.0 * planned, here, planned)
    quickest = stopping_way(caught_up, period, None)
    most = quickest + stopping_way(steady, period, GENTLE) + period * planned
    assert (stopping_way(caught_up, period, GENTLE) <= most).all()
    # A motion of that speed that is no catching up is stopped gently.
    motion = LimiterState(here, 3.0 * planned, 0.0 * planned, here, 3.0 * planned)
    assert (stopping_way(motion, period, GENTLE) > 1.5 * most).any()


@pytest.mark.parametrize("period", CYCLES)
def test_an_acceleration_beyond_the_gentle_one_is_let_go_at_the_jerk_of_the_limits(
    period: float,
) -> None:
    for way in (-1.0, 1.0):
        for had in (THREE_AXES, GENTLE):
            held = way * 0.9 * had.acceleration
            speed = way * 0.5 * THREE_AXES.speed
            state = LimiterState(REST[3], speed, held, REST[3], speed)
            after = limiter.brake(state, at(THREE_AXES, period), at(GENTLE, period))
            fallen = way * (held - after.acceleration)
            whole = np.abs(held) + GENTLE.acceleration
            assert np.allclose(fallen, np.minimum(had.jerk * period, whole), rtol=1e-6)


@pytest.mark.parametrize("period", CYCLES)
def test_a_gate_made_of_what_a_robot_does_goes_on_as_the_one_that_led_it(period: float) -> None:
    times = period * np.arange(1, 60)[:, None]
    wishes = REST[3] + 0.02 * (1.0 - np.cos(2.0 * times)) ** 2
    led = run(wishes[:-1], THREE_AXES, period).states[-1]
    made = limiter.moving(led.position, led.speed, led.acceleration)
    expected, _ = limiter.admit(led, wishes[-1], at(THREE_AXES, period))
    found, why = limiter.admit(made, wishes[-1], at(THREE_AXES, period))
    assert why is None
    assert np.abs(expected.position - led.position).min() > 1e-5
    for name in ("position", "speed", "acceleration"):
        assert getattr(found, name) == pytest.approx(getattr(expected, name), rel=1e-6)
    # From rest the same wish would be a jump.
    _, why = limiter.admit(limiter.at_rest(led.position), wishes[-1], at(THREE_AXES, period))
    assert why is not None


HARD = Limits(
    np.array((-10.0,)), np.array((10.0,)), np.array((2.0,)), np.array((8.0,)), np.array((200.0,)),
    ("A1",),
    0.012,
)  # fmt: skip
SOFT = replace(HARD, acceleration=np.array((1.0,)), jerk=np.array((20.0,)))


@pytest.mark.parametrize("period", [0.004, 0.012])
def test_a_gentle_stop_lets_a_hard_acceleration_go_at_once_and_ends_gently(period: float) -> None:
    state, rows = limiter.at_rest(np.array((0.0,))), []
    for k in range(20):
        state, _ = limiter.admit(state, np.array((0.02 * k * k,)), at(HARD, period))
    assert abs(state.acceleration[0]) > SOFT.acceleration[0]
    letting_go = True
    for _ in range(2000):
        before = state
        state = limiter.brake(state, at(HARD, period), at(SOFT, period))
        change = abs(float(state.acceleration[0] - before.acceleration[0])) / period
        letting_go = letting_go and abs(float(before.acceleration[0])) > 1.0
        assert change <= (HARD if letting_go else SOFT).jerk[0] * 1.0001
        rows.append(abs(float(state.acceleration[0])))
    assert limiter.is_standing(state)
    assert max(rows[100:]) <= 1.0001
