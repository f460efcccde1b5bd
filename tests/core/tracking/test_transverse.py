"""Across the conveyor: found, plain, predicted; with filterpy and chi-square as witnesses."""

import math
import subprocess
import sys
from dataclasses import replace
from unittest import mock

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy import linalg, stats

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.across import camera_errors, transverse
from linemate.daemon.core.tracking.across.body_sway import NO_SWAY
from linemate.daemon.core.tracking.across.transverse import (
    MOST_JUMPS,
    MOST_REJECTED,
    RATIO_DEVIATION,
    Transverse,
)
from linemate.daemon.core.tracking.across.transverse_model import FREQUENCY_FACTORS, RATIO_WALK
from linemate.daemon.core.tracking.across.transverse_state import (
    LARGEST_INFLATION,
    LEAST_INFLATION,
    STATIC,
    TURN,
    TransverseState,
)
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import CameraNoise, FusionSettings, SwingMode

T0 = 0.012
SPEED = 0.106  # of the conveyor [m/s]
FRAME = 0.025  # of a camera with 40 Hz
MODE = SwingMode()
EXACT = replace(MODE, spread=0.0)
FILTER = Transverse(FusionSettings(), (MODE,))
GATE = CameraNoise().gate
CHECKS = 3  # instants of a run at which its NEES is taken
OMEGA = 2.0 * math.pi * MODE.frequency_hz
VARIANCE = np.array((0.3e-3, 0.3e-3, 0.6e-3, 0.8e-3, 0.8e-3, 0.8e-3)) ** 2
OFF = math.radians(23.0) * np.array((0.4, -0.5, 0.768))


def angle(t: float | Array, amplitude: float = 0.006, phase: float = 0.7) -> Array:
    """The swing (8), written by its own formula: begins at ``phase`` and dies out."""
    decay = np.exp(-MODE.damping * OMEGA * np.asarray(t))
    return np.asarray(amplitude * decay * np.cos(OMEGA * np.asarray(t) + phase))


def seen(
    place: Array, rotation: Array, swing: float, delay: float, noise: Array | None = None
) -> PoseMeasurement:
    """What is measured of an object at rest at ``place`` that is turned by ``swing`` about y."""
    off = np.zeros(6) if noise is None else noise
    position = place + swing * np.array(MODE.levers) + off[:3]
    turned = rotations.exp(off[3:]) @ rotations.exp(np.array((0.0, swing, 0.0))) @ rotation
    return PoseMeasurement(position, turned, delay, VARIANCE)


PLACE = np.array((-1.06, 0.3, 2.17))


def run(
    seconds: float,
    *,
    amplitude: float = 0.0,
    delay: float = 0.1,
    jitter: float = 0.0,
    seed: int | None = None,
    rotation: Array | None = None,
) -> TransverseState:
    """A filter that starts as the tracker starts it and then runs at 12 ms with 40 images/s."""
    rng = np.random.default_rng(seed)
    turned = rotations.exp(OFF) if rotation is None else rotation

    def look(now: float) -> PoseMeasurement:
        late = delay + jitter * rng.uniform(-1.0, 1.0)
        noise = rng.normal(0.0, np.sqrt(VARIANCE)) if seed is not None else None
        return seen(PLACE, turned, float(angle(now - late, amplitude)), late, noise)

    state = FILTER.initial([look(-FRAME * i) for i in range(4, -1, -1)])
    due = FRAME
    for k in range(1, round(seconds / T0) + 1):
        state = FILTER.predict(state, T0)
        while due <= k * T0:
            state, taken = FILTER.correct(state, look(k * T0), GATE)
            assert taken
            due += FRAME
    return state


def off(state: TransverseState, rotation: Array) -> float:
    return float(np.linalg.norm(rotations.log(state.rotation @ rotation.T)))


def test_an_object_at_rest_and_23_degrees_off_is_found() -> None:
    state = run(4.0)
    assert np.allclose(state.x[:2], PLACE[[0, 2]], atol=1e-6)
    assert off(state, rotations.exp(OFF)) < 1e-6
    noisy = run(4.0, seed=1)
    assert np.abs(noisy.x[:2] - PLACE[[0, 2]]).max() < 4e-4
    assert off(noisy, rotations.exp(OFF)) < 6e-4


@settings(max_examples=15, deadline=None)
@given(st.lists(st.floats(-1.0, 1.0), min_size=3, max_size=3), st.floats(0.0, 2.5))
def test_the_orientation_may_be_off_by_any_turn(axis: list[float], size: float) -> None:
    turn = np.array(axis) * size / max(float(np.linalg.norm(axis)), 0.1)
    sightings = [seen(PLACE, rotations.exp(turn), 0.0, 0.1)] * 5
    state = FILTER.initial(sightings)
    assert off(state, rotations.exp(turn)) < 1e-9


def test_the_median_of_the_first_images_forgives_two_outliers_in_five() -> None:
    good = seen(PLACE, rotations.exp(OFF), 0.0, 0.1)
    way, turn = np.array((0.03, 0.0, -0.02)), np.array((0.05, 0.0, -0.04))
    bad = seen(PLACE + way, rotations.exp(OFF + turn), 0.0, 0.1)
    worse = seen(PLACE + 2.0 * way, rotations.exp(OFF + 2.0 * turn), 0.0, 0.1)
    state = FILTER.initial([bad, good, good, worse, good])
    assert np.allclose(state.x[:2], PLACE[[0, 2]])
    assert off(state, rotations.exp(OFF)) < 1e-3


@pytest.mark.parametrize("count", [1, 2, 3, 4, 5])
def test_the_median_of_images_is_that_of_numpy(count: int) -> None:
    rows = list(np.random.default_rng(count).normal(size=(count, 3)))
    assert transverse._median(rows).tobytes() == np.median(rows, axis=0).tobytes()


def test_the_first_images_import_nothing_while_a_robot_is_answered() -> None:
    """numpy's own median imported 20 ms of modules at the first image after a start."""
    code = (
        "import sys, numpy as np\n"
        "from linemate.daemon.core.tracking.across import transverse\n"
        "before = set(sys.modules)\n"
        "transverse._median([np.zeros(3)] * 5)\n"
        "print(sorted(set(sys.modules) - before))\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "[]\n"


def test_an_estimate_that_is_unsure_across_takes_a_felt_place_in_a_tenth_of_a_second() -> None:
    """Images have made it certain; the camera's mount is 0.5 mm wrong all the same."""
    sure = run(10.0, seed=3)
    unsure = FILTER.unsure_across(sure, 0.0005)
    place = PLACE + np.array((0.0008, 0.0, 0.0008))
    variance = np.array((0.0003**2 * 8.0, *np.ones(5)))
    felt = PoseMeasurement(place, sure.rotation, 0.0, variance)
    moved = {}
    for name, before in (("sure", sure), ("unsure", unsure)):
        state = before
        for _ in range(8):
            state, _ = FILTER.correct(FILTER.predict(state, T0), felt, 5.0)
        moved[name] = state.x[:2] - before.x[:2]
    assert moved["unsure"][0] > 2.0 * moved["sure"][0] > 0.0
    assert moved["unsure"][0] > 0.00045
    assert abs(moved["unsure"][1]) < 0.00005


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


@pytest.mark.parametrize(
    "jump",
    [
        ((0.0, 0.0, 0.0), (0.0012, -0.0015, 0.0)),  # the screws
        ((0.05, 0.0, -0.05), (0.0, 0.0, 0.0)),
        ((0.0, 0.0, 0.0), (0.2, -0.1, 0.3)),
        ((1.0, 0.0, 1.0), (1.0, 0.5, -0.5)),
    ],
)
def test_no_real_step_is_locked_out(
    jump: tuple[tuple[float, float, float], tuple[float, float, float]],
) -> None:
    state = run(3.0)
    place, rotation = PLACE + jump[0], rotations.exp(np.array(jump[1])) @ rotations.exp(OFF)
    taken = 0
    for _ in range(60):
        state = FILTER.predict(FILTER.predict(state, T0), T0)
        state, plain = FILTER.correct(state, seen(place, rotation, 0.0, 0.1), GATE)
        taken += plain
    assert taken >= 60 - MOST_JUMPS
    assert np.abs(state.x[:2] - place[[0, 2]]).max() < 0.02 * max(np.abs(jump[0]).max(), 0.01)
    assert off(state, rotation) < 0.05 * max(float(np.linalg.norm(jump[1])), 0.01)


def test_a_jump_stays_one_as_the_gate_widens() -> None:
    state = run(3.0)
    rotation = rotations.exp(OFF)
    offs = (0.0005 * k for k in range(1, 40))
    # The least offset that is beyond the gate is far from being a jump by its size.
    beyond = next(
        pose
        for pose in (
            seen(PLACE + np.array((0.0, 0.0, off_m)), rotation, 0.0, 0.1) for off_m in offs
        )
        if not FILTER.correct(state, pose, GATE)[1]
    )
    small = structs.replace(state, rejected=MOST_REJECTED - 1)
    assert FILTER.correct(small, beyond, GATE)[1]
    for rejected in range(MOST_REJECTED, MOST_JUMPS - 1):
        after, is_accepted = FILTER.correct(structs.replace(state, rejected=rejected), beyond, GATE)
        assert (after.rejected, is_accepted) == (rejected + 1, False)
    assert FILTER.correct(structs.replace(state, rejected=MOST_JUMPS - 1), beyond, GATE)[1]


def scattered(
    scale: float, *, is_camera: bool, seed: int, seconds: float = 4.0
) -> list[TransverseState]:
    """Return the states with a camera at rest whose noise is ``scale`` times the stated one."""
    rng = np.random.default_rng(seed)

    def look() -> PoseMeasurement:
        return seen(PLACE, rotations.exp(OFF), 0.0, 0.1, scale * rng.normal(0.0, np.sqrt(VARIANCE)))

    states = [FILTER.initial([look() for _ in range(5)])]
    for _ in range(round(seconds / FRAME)):
        state = FILTER.predict(states[-1], FRAME)
        states.append(FILTER.correct(state, look(), GATE, is_camera=is_camera)[0])
    return states[40:]


def test_a_camera_twice_as_noisy_as_it_tells_is_weighed_by_what_it_shows() -> None:
    ratios = []
    for seed in range(5):
        inflated = scattered(2.0, is_camera=True, seed=seed)
        plain = scattered(2.0, is_camera=False, seed=seed)
        assert all(2.5 < state.inflation < 6.0 for state in inflated[40:])
        misses = [
            np.sqrt(np.mean([(state.x[0] - PLACE[0]) ** 2 for state in states[40:]]))
            for states in (inflated, plain)
        ]
        ratios.append(misses[0] / misses[1])
    assert np.median(ratios) < 0.9


def test_a_camera_that_is_as_good_as_it_tells_is_believed_to_the_last_bit() -> None:
    for seed in range(5):
        inflated = scattered(1.0, is_camera=True, seed=seed)
        plain = scattered(1.0, is_camera=False, seed=seed)
        assert max(state.nis for state in inflated) < 0.8 * LEAST_INFLATION
        for state, other in zip(inflated, plain, strict=True):
            assert np.array_equal(state.x, other.x)
            assert np.array_equal(state.P, other.P)


def test_what_a_gate_refuses_adds_no_variance_and_what_it_lets_in_a_bounded_one() -> None:
    state = run(3.0)
    wild = seen(PLACE + np.array((0.05, 0.0, 0.0)), rotations.exp(OFF), 0.0, 0.1)
    after, plain = FILTER.correct(state, wild, GATE, is_camera=True)
    assert not plain
    assert after.nis == state.nis
    for state in scattered(8.0, is_camera=True, seed=1):
        assert 1.0 <= state.inflation <= LARGEST_INFLATION


def test_single_outliers_are_refused_and_change_nothing() -> None:
    state = run(3.0)
    for axis in (0, 2):
        wrong = seen(PLACE + 0.03 * np.eye(3)[axis], rotations.exp(OFF), 0.0, 0.1)
        after, plain = FILTER.correct(state, wrong, GATE)
        assert not plain
        assert np.array_equal(after.x, state.x)
        assert np.array_equal(after.P, state.P)
        assert after.rejected == 1
        good, plain = FILTER.correct(after, seen(PLACE, rotations.exp(OFF), 0.0, 0.1), GATE)
        assert plain
        assert good.rejected == 0


@pytest.mark.parametrize("axis", [0, 2])
def test_a_sighting_that_is_no_number_is_refused_and_changes_nothing(axis: int) -> None:
    state = run(3.0)
    place = PLACE.copy()
    place[axis] = math.nan
    nowhere = seen(place, rotations.exp(OFF), 0.0, 0.1)
    after, plain = FILTER.correct(state, nowhere, GATE, is_camera=True)
    assert not plain
    assert np.array_equal(after.x, state.x)
    assert np.array_equal(after.P, state.P)
    assert after.nis == state.nis


@settings(max_examples=20, deadline=None)
@given(
    st.integers(0, 10_000),
    st.lists(st.tuples(st.floats(-0.2, 0.2), st.floats(-0.4, 0.4), st.floats(0.0, 0.3))),
)
def test_the_covariance_stays_symmetric_and_positive_whatever_is_seen(
    seed: int, shocks: list[tuple[float, float, float]]
) -> None:
    state = FILTER.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.1)] * 5)
    rng = np.random.default_rng(seed)
    for shift, turn, delay in shocks:
        state = FILTER.predict(state, float(rng.choice((T0, 0.004, 0.1))))
        place = PLACE + shift * rng.normal(size=3)
        rotation = rotations.exp(turn * rng.normal(size=3)) @ rotations.exp(OFF)
        state, _ = FILTER.correct(state, seen(place, rotation, 0.0, delay), GATE)
        assert np.allclose(state.P, state.P.T, rtol=0.0, atol=1e-15)
        assert np.linalg.eigvalsh(state.P)[0] > 0.0
        assert np.allclose(state.rotation @ state.rotation.T, np.eye(3), atol=1e-9)


def test_the_covariance_stays_positive_over_minutes_at_250_hz() -> None:
    state = FILTER.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.1)] * 5)
    for k in range(3000):
        state = FILTER.predict(state, 0.02)
        if k % 2 == 0:
            state, _ = FILTER.correct(state, seen(PLACE, rotations.exp(OFF), 0.0, 0.1), GATE)
    assert np.linalg.eigvalsh(state.P)[0] > 0.0
    assert np.allclose(state.rotation @ state.rotation.T, np.eye(3), atol=1e-12)


def transition(dt: float, size: int, modes: tuple[SwingMode, ...]) -> Array:
    """A of (5) by scipy's exponential of the oscillators' equation."""
    generator = np.zeros((size, size))
    for m, mode in enumerate(modes):
        w, i = 2.0 * math.pi * mode.frequency_hz, STATIC + 2 * m
        d = -mode.damping * w
        generator[i : i + 2, i : i + 2] = ((d, w), (-w, d))
    generator[:2, -3:-1] = SPEED * np.eye(2)
    return np.asarray(linalg.expm(generator * dt))


def witness(state: TransverseState, modes: tuple[SwingMode, ...]) -> KalmanFilter:
    """filterpy's filter with the same model; its state holds the turn that ours folds away."""
    size = len(state.x)
    kf = KalmanFilter(dim_x=size, dim_z=STATIC)
    kf.x = state.x.copy()
    kf.x[TURN:STATIC] = rotations.log(state.rotation)
    kf.P = state.P.copy()
    fusion = FusionSettings()
    rates = [fusion.position] * 2 + [fusion.angle] * 3 + [fusion.swing] * (size - STATIC - 3)
    rates += [fusion.askew_walk] * 2 + [RATIO_WALK]
    kf.Q = np.diag(np.array(rates) ** 2) * T0
    kf.F = transition(T0, size, modes)
    kf.R = np.diag(VARIANCE[[0, 2, 3, 4, 5]])
    return kf


@pytest.mark.parametrize(
    "modes",
    [(EXACT,), (EXACT, SwingMode(1, 0.9, damping=0.01, levers=(0.2, 0.0, 0.5), spread=0.0))],
    ids=["one swing", "two swings"],
)
def test_the_recursion_is_filterpys(modes: tuple[SwingMode, ...]) -> None:
    """Turns about y alone commute, so that the error-state filter is linear and must agree."""
    own = Transverse(FusionSettings(), modes)
    rng = np.random.default_rng(11)
    tilt = np.array((0.0, 0.15, 0.0))
    state = own.initial([seen(PLACE, rotations.exp(tilt), 0.0, 0.1)] * 5)
    kf = witness(state, modes)
    size = len(state.x)
    for k in range(200):
        state = own.predict(state, T0, speed=SPEED)
        kf.predict()
        if k % 2:
            continue
        delay = float(rng.uniform(0.05, 0.15))
        noise = rng.normal(0.0, np.sqrt(VARIANCE)) * (1, 1, 1, 0, 1, 0)
        sighting = seen(PLACE, rotations.exp(tilt), float(angle(k * T0 - delay)), delay, noise)
        state, taken = own.correct(state, sighting, 50.0)
        assert taken
        H = np.zeros((STATIC, size))
        H[:, :STATIC] = np.eye(STATIC)
        back = transition(-delay, size, modes)
        for m, mode in enumerate(modes):
            row = back[STATIC + 2 * m]
            H[0] += mode.levers[0] * row
            H[1] += mode.levers[2] * row
            H[TURN + mode.axis] += row
        H[:2, -3:-1] = -delay * SPEED * np.eye(2)
        turn = rotations.log(sighting.rotation)
        R = np.diag(sighting.variance[[0, 2, 3, 4, 5]] + own._walk(delay))
        kf.update(np.concatenate((sighting.position[[0, 2]], turn)), R=R, H=H)
    static = np.r_[0, 1, STATIC:size]
    assert np.allclose(state.x[static], kf.x[static], atol=1e-12)
    assert np.allclose(rotations.log(state.rotation), kf.x[TURN:STATIC], atol=1e-12)
    assert np.allclose(state.P, kf.P, rtol=1e-8, atol=1e-18)


def squared_errors(seed: int, late: int, fusion: FusionSettings) -> list[float]:
    """NEES of one run whose truth is the filter's own model, at some instants far apart."""
    rng = np.random.default_rng(seed)
    size = STATIC + 4
    start = np.diag(np.r_[(2e-3,) * 2, (5e-3,) * 3, (4e-3,) * 2, (5e-3,) * 2] ** 2)
    F = transition(T0, size + 1, (EXACT,))[:size, :size]
    own = Transverse(fusion, (EXACT,))
    walk = np.r_[(fusion.position,) * 2, (fusion.angle,) * 3, (fusion.swing,) * 2]
    walk = np.r_[walk, (fusion.askew_walk,) * 2] * math.sqrt(T0)
    first = rng.multivariate_normal(np.zeros(size), start)
    truth = [first.copy()]
    rotation = [rotations.exp(first[TURN:STATIC]) @ rotations.exp(OFF)]
    # Nothing sways: the ratio to it, the last state, is independent of all others.
    P = linalg.block_diag(start, RATIO_DEVIATION**2)
    state = TransverseState(np.r_[PLACE[[0, 2]], np.zeros(size - 1)], P, rotations.exp(OFF))
    truth[0][:2] += PLACE[[0, 2]]
    found = []
    for k in range(1, CHECKS * 60 + 1):
        kick = walk * rng.normal(size=size)
        truth.append(F @ truth[-1] + kick)
        rotation.append(rotations.exp(kick[TURN:STATIC]) @ rotation[-1])
        state = own.predict(state, T0, speed=SPEED)
        if k % 2 == 0 and k >= late:
            then = truth[k - late]
            place = np.array((then[0], 0.0, then[1]))
            sighting = seen(
                place, rotation[k - late], then[STATIC], late * T0, rng.normal(0, np.sqrt(VARIANCE))
            )
            state, _ = own.correct(state, sighting, 8.0)
        if k % 60 == 0:
            error = truth[-1] - state.x[:size]
            error[TURN:STATIC] = rotations.log(rotation[-1] @ state.rotation.T)
            found.append(float(error @ np.linalg.solve(state.P[:size, :size], error)))
    return found


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


# A sighting's row knows how the swing came here from then, but not what else has walked since:
# with a delay the model matches only where next to nothing walks.
@pytest.mark.long
@pytest.mark.parametrize(
    ("late", "fusion"),
    [(0, FusionSettings()), (8, FusionSettings(position=1e-5, angle=2e-5, swing=1e-5))],
    ids=["at once", "96 ms late"],
)
def test_the_covariance_is_honest(late: int, fusion: FusionSettings) -> None:
    """NEES over seeded runs of a matching model lies in its 95 % band."""
    nees = np.array([squared_errors(seed, late, fusion) for seed in range(72)])
    low, high = stats.chi2.ppf((0.025, 0.975), nees.size * (STATIC + 4)) / nees.size
    assert low < nees.mean() < high


def test_a_conveyor_that_is_askew_is_learnt_while_it_runs_and_stands_when_it_stands() -> None:
    slopes = (0.01, -0.006)

    def place(t: float) -> Array:
        way = SPEED * min(t, 4.0)
        return PLACE + np.array((slopes[0] * way, way, slopes[1] * way))

    delay, rng = 0.1, np.random.default_rng(3)

    def look(now: float) -> PoseMeasurement:
        noise = rng.normal(0.0, np.sqrt(VARIANCE))
        return seen(place(now - delay), rotations.exp(OFF), 0.0, delay, noise)

    state = FILTER.initial([look(-FRAME * i) for i in range(4, -1, -1)])
    for k in range(1, round(5.0 / T0)):
        state = FILTER.predict(state, T0, speed=SPEED if k * T0 < 4.0 else 0.0)
        if k % 2 == 0:
            state, taken = FILTER.correct(state, look(k * T0), GATE)
            assert taken
    assert np.allclose(FILTER.slopes(state), slopes, atol=1.2e-3)
    assert np.abs(state.x[:2] - place(5.0)[[0, 2]]).max() < 0.3e-3


def felt(x: float, state: TransverseState) -> PoseMeasurement:
    """A deflection as the filter across the conveyor takes it of an object that gives way."""
    variance = np.r_[(2.4e-3,) * 3, (2.4e-3,) * 3] ** 2
    place = np.array((x, 0.0, float(state.x[1])))
    return PoseMeasurement(place, state.rotation, 0.0, variance)


@pytest.mark.parametrize("ratio", [-0.4, 0.25])
def test_a_body_that_pitches_in_step_with_its_sway_is_led_after_an_eighth_of_it(
    ratio: float,
) -> None:
    """12 mm along at 0.7 Hz: by the first extreme x has moved by 3 to 5 mm."""
    state = run(1.0)
    begin, before = float(state.x[0]), 0.0
    for k in range(1, 60):
        sway = 0.012 * math.sin(2.0 * math.pi * 0.7 * k * T0)
        state = FILTER.predict(state, T0, swayed=sway - before)
        before = sway
        measured = felt(begin + ratio * sway, state)
        state, _ = FILTER.correct(FILTER.correct_ratio(state, measured, T0), measured, 20.0)
        if k * T0 > 0.125 / 0.7:
            assert float(state.x[0]) == pytest.approx(begin + ratio * sway, abs=0.8e-3)
    assert FILTER.ratio(state) == pytest.approx(ratio, rel=0.15)


def test_a_felt_pose_without_a_sway_moves_the_object_no_sooner() -> None:
    state = run(1.0)
    x = float(state.x[0])
    for _ in range(20):
        state = FILTER.predict(state, T0)
        after = FILTER.correct_ratio(state, felt(x + 0.003, state), T0)
        assert float(after.x[0]) == pytest.approx(float(state.x[0]), abs=1e-9)
        state = after
    assert FILTER.ratio(state) == 0.0


def test_a_part_that_is_off_in_a_quiet_contact_shows_no_ratio_as_the_body_sways() -> None:
    """2 mm off for 8 s, and a sway of 3 mm then: read as a ratio, that gave 1200 N."""
    state = run(1.0)
    x, sway = float(state.x[0]), 0.0
    for k in range(700):
        way = 0.03 * T0 if k > 600 else 0.0
        sway += way
        state = FILTER.predict(state, T0, swayed=way)
        state = FILTER.correct_ratio(state, felt(x + 0.002, state), T0)
    assert sway == pytest.approx(0.0356, rel=0.01)
    assert abs(FILTER.ratio(state)) < 0.01


def test_a_sway_that_jumps_or_drifts_is_another_estimate() -> None:
    sway, drift = NO_SWAY.moved(0.01, T0), 0.0
    assert sway.way == 0.0
    assert sway.moved(0.011, T0).way == pytest.approx(0.001, rel=0.01)
    assert sway.moved(0.02, T0).way == 0.0
    for _ in range(500):
        drift += 0.001 * T0
        sway = sway.moved(0.01 + drift, T0)
    assert drift == pytest.approx(0.006)
    assert sway.off < 0.0016


def test_a_conveyor_configured_straight_is_never_askew() -> None:
    own = Transverse(FusionSettings(askew=0.0, askew_walk=0.0), (MODE,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    for k in range(1, 100):
        moved = PLACE + 0.01 * SPEED * k * T0
        state = own.predict(state, T0, speed=SPEED)
        state, _ = own.correct(state, seen(moved, rotations.exp(OFF), 0.0, 0.0), GATE)
    assert own.slopes(state) == (0.0, 0.0)


class TestCameraErrors:
    """Stamp and bias of the camera, from the arm's own motion."""

    OWN = Transverse(FusionSettings(), (), CameraNoise(stamp_offset=0.01, bias=0.003))

    def estimate(
        self, offset: float, bias: tuple[float, float, float], *, moves: bool = True
    ) -> tuple[TransverseState, Array, Array]:
        """Return the estimate, the errors' estimates and sigmas, after an approach of 4 s."""
        chance = np.random.default_rng(3)
        place, sigma, state = np.array((0.1, 0.0, 0.5)), np.sqrt(VARIANCE), None
        first: list[PoseMeasurement] = []
        for i in range(160):
            t = i * FRAME
            share = min(t / 4.0, 1.0) if moves else 0.0
            rate = 0.25 if moves else 0.0
            # The tool comes nearer along z and follows sideways.
            motion = np.array((0.3 * rate, 0.0, rate, 0.0, 0.0, 0.0))
            distance = 0.55 - 0.35 * share
            sensitivity = np.zeros((6, 4))
            sensitivity[:, 0] = motion * (1.0 if int(t) % 2 == 0 else -1.0)
            sensitivity[:3, 1:] = distance * np.eye(3)
            error = sensitivity @ np.array((offset, *bias))
            seen_at = place + error[:3] + sigma[:3] * chance.standard_normal(3)
            turned = rotations.exp(sigma[3:] * chance.standard_normal(3))
            measured = PoseMeasurement(seen_at, turned, 0.0, VARIANCE, sensitivity)
            if state is None:
                first.append(measured)
                state = self.OWN.initial(first) if len(first) == 5 else None
                continue
            state, _ = self.OWN.correct(self.OWN.predict(state, FRAME), measured, GATE)
            state = self.OWN.correct_along(state, measured, -0.05)
        assert state is not None
        k = slice(self.OWN._camera, self.OWN._camera + 4)
        return state, state.x[k], np.sqrt(np.diag(state.P)[k])

    @pytest.mark.parametrize("offset", [-0.02, 0.0, 0.02])
    def test_the_error_of_a_stamp_is_found_from_the_arms_motion(self, offset: float) -> None:
        _, errors, sigmas = self.estimate(offset, (0.0, 0.0, 0.0))
        assert sigmas[0] < 0.0006
        assert abs(errors[0] - offset) < 3.0 * sigmas[0] + 0.02 * abs(offset)

    def test_a_bias_that_grows_with_the_range_is_found_as_the_range_changes(self) -> None:
        bias = (0.003, -0.002, 0.004)
        state, errors, sigmas = self.estimate(0.0, bias)
        assert np.all(np.abs(errors[1:] - bias) < 3.0 * sigmas[1:])
        assert np.all(sigmas[1:] < 0.0015)
        assert abs(state.x[0] - 0.1) < 0.0006
        assert abs(state.x[1] - 0.5) < 0.0009

    def test_errors_that_are_not_there_are_mostly_taken_back(self) -> None:
        state, errors, _ = self.estimate(0.0, (0.0, 0.0, 0.0))
        believed = self.OWN.believed(self.OWN.doubted(state)).x
        k = self.OWN._camera
        assert np.all(np.abs(believed[k : k + 4]) < 0.2 * np.abs(errors))

    def test_an_error_that_is_surely_there_stays_whole(self) -> None:
        state, errors, _ = self.estimate(0.02, (0.003, -0.002, 0.004))
        doubted = self.OWN.doubted(state)
        believed, k = self.OWN.believed(doubted).x, self.OWN._camera
        assert believed[k : k + 4] == pytest.approx(errors, rel=0.1)
        assert doubted.errors is not None
        assert np.diag(doubted.errors) == pytest.approx(np.diag(state.P)[k : k + 4], rel=0.2)

    def test_an_object_without_errors_is_where_a_filter_without_them_has_it(self) -> None:
        state, _, _ = self.estimate(0.0, (0.0, 0.0, 0.0))
        with mock.patch.object(camera_errors, "NONE_ODDS", 1e9):
            believed = self.OWN.believed(self.OWN.doubted(state))
        k, n = self.OWN._slope, self.OWN._camera + 4
        P, x = state.P, state.x
        gain = np.linalg.solve(P[k:n, k:n], P[k:n])
        assert believed.x[:2] == pytest.approx((x - x[k:n] @ gain)[:2], abs=1e-7)
        assert np.all(np.abs(believed.x[k:n]) < 1e-7)

    def test_a_tool_at_rest_learns_nothing_of_the_stamp(self) -> None:
        _, errors, sigmas = self.estimate(0.02, (0.0, 0.0, 0.0), moves=False)
        assert sigmas[0] > 0.0099
        assert abs(errors[0]) < 1e-9

    def test_a_pose_without_its_errors_is_where_the_object_is(self) -> None:
        state, _, _ = self.estimate(0.02, (0.0, 0.0, 0.0))
        sensitivity = np.zeros((6, 4))
        sensitivity[2, 0] = 0.25
        off = PoseMeasurement(np.array((0.1, 0.0, 0.505)), np.eye(3), 0.0, VARIANCE, sensitivity)
        right = self.OWN.without_errors(state, off)
        assert right.position[2] == pytest.approx(0.5, abs=0.0003)
        assert right.variance[2] > off.variance[2]


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


class TestLastingNoise:
    """A camera whose images err together for a while."""

    SIGMA, TURNED, TIME_S = 0.4e-3, 0.5e-3, 0.5

    def missed(self, model: Transverse, seed: int) -> float:
        """Return the squared error of x and z over their stated variance, after 3 s."""
        chance = np.random.default_rng(seed)
        place, sigma, lasting = np.array((0.1, 0.0, 0.5)), np.sqrt(VARIANCE), np.zeros(6)
        size = np.array((*(self.SIGMA,) * 3, *(self.TURNED,) * 3))
        kept, state = math.exp(-FRAME / self.TIME_S), None
        first: list[PoseMeasurement] = []
        lasting = size * chance.standard_normal(6)
        for _ in range(120):
            fresh = math.sqrt(1.0 - kept * kept) * size * chance.standard_normal(6)
            lasting = kept * lasting + fresh
            error = lasting + sigma * chance.standard_normal(6)
            turned, far = rotations.exp(error[3:]), (self.SIGMA * np.eye(3), self.TURNED)
            measured = PoseMeasurement(place + error[:3], turned, 0.0, VARIANCE, None, far)
            if state is None:
                first.append(measured)
                state = model.initial(first) if len(first) == 5 else None
                continue
            state = model.predict(state, FRAME)
            state, _ = model.correct(state, measured, GATE, is_camera=True)
        assert state is not None
        off = state.x[:2] - place[[0, 2]]
        return float(off @ np.linalg.solve(state.P[:2, :2], off)) / 2.0

    def test_the_stated_error_holds_where_images_err_together(self) -> None:
        camera = CameraNoise(stamp_offset=0.0, bias=0.0, lasting=1.0, lasting_s=self.TIME_S)
        own = Transverse(FusionSettings(), (), camera)
        plain = Transverse(FusionSettings(), (), replace(camera, lasting=0.0))
        seeds = range(100)
        low, high = stats.chi2.ppf((0.001, 0.999), 2 * len(seeds)) / (2 * len(seeds))
        assert low < np.mean([self.missed(own, seed) for seed in seeds]) < high
        assert np.mean([self.missed(plain, seed) for seed in seeds]) > 2.0 * high
