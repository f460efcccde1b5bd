"""Swings across the conveyor: from late images, at another frequency, driven by stops."""

import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from transverse_runs import (
    EXACT,
    FILTER,
    FRAME,
    GATE,
    MODE,
    OFF,
    OMEGA,
    PLACE,
    SPEED,
    T0,
    VARIANCE,
    angle,
    off,
    run,
    seen,
)

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across import transverse
from linemate.daemon.core.tracking.across.transverse import Transverse
from linemate.daemon.core.tracking.across.transverse_model import FREQUENCY_FACTORS
from linemate.daemon.core.tracking.across.transverse_state import STATIC, TransverseState
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import FusionSettings, SwingMode


@pytest.mark.parametrize("delay", [0.0, 0.0853, 0.1, 0.21])
def test_the_swing_is_found_from_delayed_sightings_and_predicted(delay: float) -> None:
    seconds = 6.0
    state = run(seconds, amplitude=0.006, delay=delay)
    ahead = np.linspace(0.0, 0.5, 40)
    known = angle(seconds + ahead, 0.006)
    assert np.abs(FILTER.swing_angles(state, ahead)[0] - known).max() < 0.03e-3
    found = float(np.hypot(*state.x[STATIC : STATIC + 2]))
    assert found == pytest.approx(0.006 * math.exp(-MODE.damping * OMEGA * seconds), rel=0.01)
    assert off(state, rotations.exp(OFF)) < 0.05e-3
    assert np.allclose(state.x[:2], PLACE[[0, 2]], atol=0.03e-3)


def test_delays_that_jitter_cost_nothing_for_each_is_measured() -> None:
    seconds = 6.0
    state = run(seconds, amplitude=0.006, jitter=0.015)
    ahead = np.linspace(0.0, 0.5, 40)
    assert np.abs(FILTER.swing_angles(state, ahead)[0] - angle(seconds + ahead)).max() < 0.03e-3


def test_the_swing_a_while_ago_is_what_the_rows_take_it_for() -> None:
    state = run(3.0, amplitude=0.006)
    for delay in (0.0, 0.05, 0.2):
        rows = FILTER.observation_rows(state, delay)[:, STATIC:] @ state.x[STATIC:]
        back = float(FILTER.swing_angles(state, np.array((-delay,)))[0, 0])
        levers = MODE.levers
        known = (levers[0] * back, levers[2] * back, 0.0, back, 0.0)
        assert np.allclose(rows, known, atol=1e-12)


def test_the_swing_carries_on_while_the_camera_is_blind() -> None:
    state = run(6.0, amplitude=0.006)
    for _ in range(round(1.5 / T0)):
        state = FILTER.predict(state, T0)
    assert float(FILTER.swing_angles(state, np.zeros(1))[0, 0]) == pytest.approx(
        float(angle(7.5)), abs=0.06e-3
    )


def swinging_at(pace: float, seconds: float, amplitude: float = 0.006) -> TransverseState:
    """A filter whose object swings at ``pace`` times the configured frequency."""
    rng = np.random.default_rng(3)
    turned = rotations.exp(OFF)

    def look(now: float) -> PoseMeasurement:
        late = 0.1 + 0.015 * rng.uniform(-1.0, 1.0)
        noise = rng.normal(0.0, np.sqrt(VARIANCE))
        return seen(PLACE, turned, float(angle(pace * (now - late), amplitude)), late, noise)

    state = FILTER.initial([look(-FRAME * i) for i in range(4, -1, -1)])
    due = FRAME
    for k in range(1, round(seconds / T0) + 1):
        state = FILTER.predict(state, T0)
        while due <= k * T0:
            state, _ = FILTER.correct(state, look(k * T0), GATE)
            due += FRAME
    return state


@pytest.mark.parametrize("pace", [0.95, 0.98, 1.05])
def test_a_frequency_that_is_wrong_is_found_and_the_swing_foreseen_with_it(pace: float) -> None:
    seconds = 7.2
    state = swinging_at(pace, seconds)
    assert state.frequency_factors[0] == pytest.approx(pace, abs=0.006)
    ahead = np.linspace(0.0, 0.5, 40)
    known = angle(pace * (seconds + ahead))
    assert np.abs(FILTER.swing_angles(state, ahead)[0] - known).max() < 0.3e-3


def test_an_object_that_does_not_swing_tells_nothing_of_a_frequency() -> None:
    state = swinging_at(1.0, 7.2, amplitude=0.0)
    assert abs(state.frequency_factors[0] - 1.0) < 0.02
    assert math.sqrt(state.P[-1, -1]) > 0.5 * MODE.spread


def test_a_frequency_stays_near_what_was_identified_whatever_is_seen() -> None:
    state = swinging_at(1.6, 7.2)
    assert FREQUENCY_FACTORS[0] <= state.frequency_factors[0] <= FREQUENCY_FACTORS[1]


def test_a_frequency_taken_for_exact_has_no_state() -> None:
    own = Transverse(FusionSettings(), (EXACT, MODE))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.1)] * 5)
    assert len(state.x) == own.size == STATIC + 4 + 3 + 1
    for k in range(40):
        sighting = seen(PLACE, rotations.exp(OFF), float(angle(k * T0)), 0.0)
        state, _ = own.correct(own.predict(state, T0), sighting, GATE)
    assert state.frequency_factors[0] == 1.0


def test_a_wrong_pace_enters_the_rows_and_the_transition_as_it_enters_the_swing() -> None:
    state = run(4.0, amplitude=0.006)
    off = 1e-4
    faster = structs.replace(state, frequency_factors=(state.frequency_factors[0] + off,))
    for delay in (0.0, 0.1, 0.25):
        column = FILTER.observation_rows(state, delay)[:, -1]
        rows = [FILTER.observation_rows(each, delay) @ each.x for each in (faster, state)]
        assert np.allclose(column, (rows[0] - rows[1]) / off, rtol=0.02, atol=2e-6)
    late = 0.3
    moved = [FILTER.predict(each, late).x for each in (faster, state)]
    kicked = structs.replace(state, P=np.zeros_like(state.P))
    kicked.P[-1, -1] = 1.0
    noise = FILTER.fusion
    P = FILTER.predict(kicked, late).P
    slope = (moved[0] - moved[1]) / off
    assert P[STATIC, -1] == pytest.approx(float(slope[STATIC]), rel=0.02, abs=2e-6)
    assert P[STATIC + 1, -1] == pytest.approx(float(slope[STATIC + 1]), rel=0.02, abs=2e-6)
    assert P[-1, -1] == pytest.approx(1.0 + noise.pace**2 * late)


def test_a_step_of_the_orientation_is_no_swing_while_the_tool_seats_itself() -> None:
    """The screws' 1.5 mrad: what the filter makes of them in the swing, expected and not."""
    swings = []
    for seating in (True, False):
        state = run(5.0, amplitude=0.004)
        fine = np.array((50e-6, 50e-6, 50e-6, 2e-4, 2e-4, 2e-4)) ** 2
        for k in range(60):
            now = 5.0 + (k + 1) * T0
            step = rotations.exp(np.array((0.0, min(k / 4.0, 1.0) * -0.0015, 0.0)))
            sighting = seen(PLACE, step @ rotations.exp(OFF), float(angle(now, 0.004)), 0.0)
            state = FILTER.predict(state, T0, seating=seating)
            state, _ = FILTER.correct(state, structs.replace(sighting, variance=fine), 20.0)
        ahead = np.linspace(0.0, 0.4, 30)
        found = FILTER.swing_angles(state, ahead)[0] - angle(now + ahead, 0.004)
        swings.append(float(np.abs(found).max()))
    expected, unexpected = swings
    assert expected < 0.05e-3
    assert expected < 0.5 * unexpected


SHIFT = SwingMode(
    1, 0.9, damping=0.02, levers=(0.0, 0.0, 10.0), spread=0.0, gain=0.3, gain_deviation=0.05
)
"""A mode that shifts the object along z and does not turn it; stops and starts excite it."""
STOPS_S, END_S, DECELERATION = 3.0, 3.6, 0.104


def speed_at(t: float) -> float:
    return min(max(SPEED - DECELERATION * (t - STOPS_S), 0.0), SPEED)


def shifted(gain: float, rate: float = 2.5e-4) -> Array:
    """The true shift along z [m] at steps of ``rate``, by its own small steps of the equation."""
    w, z, v = 2.0 * math.pi * SHIFT.frequency_hz, 0.0, 0.0
    way = [z]
    for k in range(round(END_S / rate)):
        a = -DECELERATION if 0.0 < speed_at(k * rate) < SPEED else 0.0
        v += rate * (-gain * a - 2.0 * SHIFT.damping * w * v - w * w * z)
        z += rate * v
        way.append(z)
    return np.interp(np.arange(round(END_S / T0) + 1) * T0, np.arange(len(way)) * rate, way)


def stopped(mode: SwingMode, *, gain: float, blind_s: float) -> TransverseState:
    """A filter 0.6 s after the onset of a stop, which saw nothing for the last ``blind_s``."""
    own = Transverse(FusionSettings(), (mode,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    way, due = shifted(gain), FRAME
    for k in range(1, len(way)):
        now = k * T0
        state = own.predict(state, T0, speed=speed_at(now))
        if due <= now < END_S - blind_s:
            due += FRAME
            place = PLACE + np.array((0.0, 0.0, way[k]))
            state, taken = own.correct(state, seen(place, rotations.exp(OFF), 0.0, 0.0), GATE)
            assert taken
    return state


def z_error(mode: SwingMode, *, gain: float, blind_s: float) -> tuple[float, float]:
    """Error of z at the end, and its deviation [m]."""
    own, state = Transverse(FusionSettings(), (mode,)), stopped(mode, gain=gain, blind_s=blind_s)
    H = own.observation_rows(state, 0.0)[1]
    return float(H @ state.x) - PLACE[2] - shifted(gain)[-1], math.sqrt(float(H @ state.P @ H))


def test_a_stop_that_no_image_shows_moves_the_object_by_its_gain() -> None:
    error, deviation = z_error(SHIFT, gain=SHIFT.gain, blind_s=0.6)
    assert abs(error) < 0.05e-3
    assert deviation < 0.5e-3
    unknown, _ = z_error(replace(SHIFT, gain=0.0), gain=SHIFT.gain, blind_s=0.6)
    assert abs(unknown) > 1.5e-3


def test_another_gain_is_within_the_deviation_and_found_from_images() -> None:
    error, deviation = z_error(SHIFT, gain=SHIFT.gain + 0.1, blind_s=0.6)
    assert 0.3e-3 < abs(error) < 3.0 * deviation
    late = stopped(SHIFT, gain=SHIFT.gain + 0.1, blind_s=0.0)
    assert SHIFT.gain + 0.03 < float(late.x[-1]) < SHIFT.gain + 0.12


def test_a_speed_that_becomes_known_is_no_stop_and_no_start() -> None:
    own = Transverse(FusionSettings(), (SHIFT,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    later = own.predict(state, T0, speed=SPEED)
    assert list(own.swing_now(later, 0.0)) == [0.0]


def test_a_mode_with_a_long_lever_walks_as_far_at_the_object_as_one_of_a_metre() -> None:
    own = Transverse(FusionSettings(), (SHIFT,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    later = own.predict(state, T0)
    grown = float(later.P[STATIC, STATIC]) * SHIFT.lever**2
    assert grown == pytest.approx(transverse.SWING_DEVIATION**2, rel=0.01)


def way_at(t: float) -> float:
    """Way of the conveyor [m]; it still moves at the end."""
    return SPEED * t - 0.5 * DECELERATION * max(t - STOPS_S, 0.0) ** 2


@pytest.mark.parametrize(("tells_way", "largest"), [(True, 0.1e-3), (False, 0.5e-3)])
def test_a_stop_that_is_known_late_moves_the_object_as_if_it_were_known(
    tells_way: bool, largest: float
) -> None:
    own = Transverse(FusionSettings(), (SHIFT,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    for k in range(1, round(END_S / T0) + 1):
        before = (k - 1) * T0
        is_known = not STOPS_S < before < STOPS_S + 0.17
        unit = way_at(before) if is_known else SPEED * before
        speed = speed_at(before) if is_known else SPEED
        state = own.predict(state, T0, speed=speed, unit=unit if tells_way else None)
    z = float(own.observation_rows(state, 0.0)[1] @ state.x)
    error = z - PLACE[2] - shifted(SHIFT.gain)[-1]
    assert 0.6 * largest * (not tells_way) < abs(error) < largest


def test_a_sensor_that_jumps_does_not_move_the_object() -> None:
    own = Transverse(FusionSettings(), (SHIFT,))
    state = structs.replace(
        own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5), speed=SPEED, unit=0.0
    )
    later = own.predict(state, T0, speed=SPEED, unit=0.02)
    assert later.x == pytest.approx(state.x, abs=1e-12)
    assert later.unit == 0.02


def test_a_ramp_that_is_predicted_moves_the_object_in_the_prediction() -> None:
    own = Transverse(FusionSettings(), (SHIFT,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    times, true = np.array((0.0, 0.1, 0.2, 0.3)), shifted(SHIFT.gain)
    angles = own.driven_angles(state, times, -0.5 * DECELERATION * times**2)
    true = np.interp(STOPS_S + times, np.arange(len(true)) * T0, true)
    assert angles[0] * SHIFT.lever == pytest.approx(true, abs=0.03e-3)
    assert own.is_driven
    assert not Transverse(FusionSettings(), (replace(SHIFT, gain=0.0),)).is_driven


def watched(own: Transverse, state: TransverseState, amplitude: float) -> TransverseState:
    """The estimate after 1.2 s of images of an object that sways by 0.9 Hz."""
    due = 0.0
    for k in range(1, 101):
        state = own.predict(state, T0)
        if k * T0 >= due:
            due += FRAME
            z = amplitude * math.sin(2.0 * math.pi * SHIFT.frequency_hz * k * T0)
            place = PLACE + np.array((0.0, 0.0, z))
            state, _ = own.correct(state, seen(place, rotations.exp(OFF), 0.0, 0.0), GATE)
    return state


def test_images_show_how_an_object_sways_that_was_pushed() -> None:
    own, amplitude = Transverse(FusionSettings(), (SHIFT,)), 0.003
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    for _ in range(4):
        state = watched(own, state, 0.0)

    def error(later: TransverseState) -> float:
        span = np.array((0.0, 0.3, 0.6))
        z = float(later.x[1]) + SHIFT.lever * own.swing_angles(later, span)[0] - PLACE[2]
        angle = 2.0 * math.pi * SHIFT.frequency_hz * (100 * T0 + span)
        return float(np.abs(z - amplitude * np.sin(angle)).max())

    known = error(watched(own, own.pushed(state), amplitude))
    assert known < 0.0005
    assert error(watched(own, state, amplitude)) > 3.0 * known
