"""Across the conveyor: found, plain, predicted; with filterpy and chi-square as witnesses."""

import math
import subprocess
import sys

import numpy as np
import pytest
from filterpy.kalman import KalmanFilter
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from scipy import linalg, stats
from transverse_runs import (
    EXACT,
    FILTER,
    FRAME,
    GATE,
    MODE,
    OFF,
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
from linemate.daemon.core.tracking.across.transverse import (
    MOST_JUMPS,
    MOST_REJECTED,
    RATIO_DEVIATION,
    Transverse,
)
from linemate.daemon.core.tracking.across.transverse_model import RATIO_WALK
from linemate.daemon.core.tracking.across.transverse_state import (
    LARGEST_INFLATION,
    LEAST_INFLATION,
    STATIC,
    TURN,
    TransverseState,
)
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.settings import FusionSettings, SwingMode

CHECKS = 3  # instants of a run at which its NEES is taken


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


def test_a_conveyor_configured_straight_is_never_askew() -> None:
    own = Transverse(FusionSettings(askew=0.0, askew_walk=0.0), (MODE,))
    state = own.initial([seen(PLACE, rotations.exp(OFF), 0.0, 0.0)] * 5)
    for k in range(1, 100):
        moved = PLACE + 0.01 * SPEED * k * T0
        state = own.predict(state, T0, speed=SPEED)
        state, _ = own.correct(state, seen(moved, rotations.exp(OFF), 0.0, 0.0), GATE)
    assert own.slopes(state) == (0.0, 0.0)
