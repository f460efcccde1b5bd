"""The bank's evidence is a likelihood ratio: against a second filter for every hypothesis."""

import itertools
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from conveyor_bank import BANK, CAMERA_DELAY, FUSION, NEVER, SETTINGS, TOUCH
from conveyor_truth import DEVIATION, NOMINAL, START, STOP, T0, Truth
from filterpy.kalman import KalmanFilter
from msgspec import structs
from scipy import integrate

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.classifiers import (
    bank_filter,
    bank_prediction,
    classifier_bank,
    onset_bank,
)
from linemate.daemon.core.tracking.classifiers.bank_filter import SETTLING
from linemate.daemon.core.tracking.classifiers.bank_model import ACCELERATION, STATES, BankState, V
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings, ImpulseSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

HESITATES = -0.06  # acceleration of a drive that stalls as it starts [m/s^2]
PRIOR = onset_bank.AmplitudePrior(1.0, SETTINGS.amplitude_deviation**2)


def measured(truth: Truth, seed: int) -> list[list[PositionMeasurement]]:
    """Rows of some steps: a distance at each, a late camera at every second."""
    rng = np.random.default_rng(seed)
    steps = []
    for k in range(round(1.2 / T0)):
        t = k * T0
        value = float(truth.at(t - 0.001)) + rng.normal(0.0, DEVIATION)
        rows = [PositionMeasurement(Source.DISTANCE, value, 0.001, DEVIATION**2, NEVER)]
        if k % 2:
            value = float(truth.at(t - CAMERA_DELAY)) + rng.normal(0.0, 5e-4)
            rows.append(PositionMeasurement(Source.CAMERA, value, CAMERA_DELAY, 25e-8, NEVER))
        steps.append(rows)
    return steps


def outcome(
    steps: list[list[PositionMeasurement]], bank: BankClassifier = BANK
) -> tuple[BankState, int, BankState]:
    """The state before the bank has hypotheses, its step, and the state at the end."""
    state = bank.initial(steps[0][0].value)
    start, first = state, 0
    for k, rows in enumerate(steps[1:], 1):
        state = bank.advance(state, rows, T0)
        if len(state.changes.age) == 0:
            start, first = state, k
    return start, first, state


def log_likelihood(
    start: BankState,
    steps: list[list[PositionMeasurement]],
    onset: float,
    amplitude: float,
    first: int,
) -> float:
    """A whole filter of its own, filterpy's, whose world has had a change since ``onset``."""
    kf = KalmanFilter(dim_x=5, dim_z=1)
    kf.x, kf.P = start.x[:5].copy(), start.P[:5, :5].copy()
    kf.F = np.eye(5)
    kf.F[0, 1] = kf.F[0, 2] = kf.F[1, 4] = T0
    kf.F[0, 4], kf.F[2, 2] = 0.5 * T0 * T0, math.exp(-T0 / FUSION.ripple_time)
    kf.Q = np.diag((1e-12, FUSION.speed**2 * T0, 0.0, FUSION.offset**2 * T0, 0.0))
    total = 0.0
    for k, rows in enumerate(steps[first + 1 :], first + 1):
        kf.predict()
        for row in rows:
            moved = max(k * T0 - row.delay - onset, 0.0)
            change = -0.5 * STOP * moved * moved
            seen = 1.0 if row.source is Source.DISTANCE else 0.0
            H = np.array(((1.0, -row.delay, -row.delay, seen, 0.0),))
            kf.update(
                np.array((row.value - amplitude * change,)), R=np.array(((row.variance,),)), H=H
            )
            total += float(kf.log_likelihood)
    return total


@pytest.mark.parametrize("events", [(), ((0.95, -STOP),)], ids=["running on", "a stop at 0.95 s"])
def test_evidence_is_the_likelihood_ratio_of_a_filter_for_each_hypothesis(
    events: tuple[tuple[float, float], ...],
) -> None:
    steps = measured(Truth(1.5, events), seed=3)
    start, first, state = outcome(steps)
    assert start.age <= SETTLING + 1e-9
    evidence, _ = onset_bank.likelihood_ratios(state.changes, BANK.change_prior)
    now = (len(steps) - 1) * T0
    null = log_likelihood(start, steps, now, 0.0, first)
    for j in (2, 12, 30, len(evidence) - 1):
        onset = now - float(state.changes.age[j])
        full, opposite = (
            log_likelihood(start, steps, onset, amplitude, first) - null
            for amplitude in (1.0, -1.0)
        )
        # A linear filter's likelihood is a parabola of the amplitude: three filters tell it all.
        A, B = -(full + opposite), 0.5 * (full - opposite)
        assert state.changes.A[j] == pytest.approx(A, rel=1e-6)
        assert state.changes.B[j] == pytest.approx(B, rel=1e-6, abs=1e-6)
        assert evidence[j] == pytest.approx(integrated(A, B), rel=1e-6, abs=1e-6)


def integrated(A: float, B: float) -> float:
    """ln of the mean of exp(a B - a^2 A / 2) over amplitudes a ~ N(1, s^2), by quadrature."""
    s = SETTINGS.amplitude_deviation
    peak = (B * s * s + 1.0) / (A * s * s + 1.0)

    def exponent(a: float) -> float:
        return a * B - 0.5 * a * a * A - 0.5 * ((a - 1.0) / s) ** 2

    width = s / math.sqrt(1.0 + s * s * A)
    total, _ = integrate.quad(
        lambda a: math.exp(exponent(a) - exponent(peak)), peak - 9 * width, peak + 9 * width
    )
    return exponent(peak) + math.log(total / (s * math.sqrt(2.0 * math.pi)))


def test_the_best_hypothesis_is_the_onset_that_was() -> None:
    steps = measured(Truth(1.5, ((0.9, -STOP),)), seed=4)
    _, _, state = outcome(steps)
    best = state.changes.age[
        int(np.argmax(onset_bank.likelihood_ratios(state.changes, BANK.change_prior)[0]))
    ]
    assert best == pytest.approx(1.2 - 0.9, abs=0.06)
    assert state.change_odds > 10.0


def test_a_conveyor_that_speeds_up_is_no_stop() -> None:
    begun = onset_bank.begin(np.zeros(STATES), (0.0,))
    faster = structs.replace(begun, sums=np.array(((1e4,), (-3e4,), (0.5,), (0.0,), (1.0,))))
    assert onset_bank.posterior(faster, PRIOR).odds <= onset_bank.NONE


@pytest.mark.parametrize("found", [-0.08, -0.095, -0.104, -0.12, -0.14])
@pytest.mark.parametrize("sigma", [0.004, 0.008])
def test_a_ramp_is_as_set_as_far_as_the_readings_let_it(found: float, sigma: float) -> None:
    """Against the posterior of the two priors together, by quadrature over accelerations."""
    nominal, settings = -BANK.conveyor.deceleration, BANK.bank
    x, P = np.zeros(STATES), np.zeros((STATES, STATES))
    x[ACCELERATION], P[ACCELERATION, ACCELERATION] = found, sigma**2
    state = structs.replace(BANK.initial(0.0), x=x, P=P, motion=Motion.STOPPING)
    a = np.linspace(-0.25, 0.05, 30001)
    wide, narrow = (
        gaussian(a, nominal, share * nominal)
        for share in (settings.amplitude_deviation, settings.as_set_deviation)
    )
    outcome = gaussian(a, found, sigma) / wide  # by the readings alone
    weights = outcome * (settings.as_set * narrow + (1.0 - settings.as_set) * wide)
    expected = float((a * weights).sum() / weights.sum())
    assert bank_prediction.ramp_estimate(BANK, state)[ACCELERATION] == pytest.approx(
        expected, abs=0.03 * sigma
    )


def gaussian(a: Array, mean: float, sigma: float) -> Array:
    """A density (m,) at ``a``."""
    density: Array = np.exp(-0.5 * ((a - mean) / sigma) ** 2) / abs(sigma)
    return density


@pytest.mark.parametrize("motion", [Motion.RUNNING, Motion.STANDING])
def test_only_a_ramp_has_been_set(motion: Motion) -> None:
    state = structs.replace(BANK.initial(0.0), motion=motion)
    assert bank_prediction.ramp_estimate(BANK, state) is state.x


@pytest.mark.parametrize("share", [0.75, 1.0, 1.25])
def test_the_amplitude_of_a_stop_is_found_with_its_onset(share: float) -> None:
    truth = Truth(3.5, ((1.0, -share * STOP),), ripple=0.0)
    bank = replace(BANK, bank=BankSettings(), mixture=False)
    state = bank.initial(float(truth.at(-1.5)))
    errors = {}
    for t in np.arange(-1.5 + T0, 1.6, T0):
        value = float(truth.at(t - 0.001))
        state = bank.advance(
            state, [PositionMeasurement(Source.DISTANCE, value, 0.001, DEVIATION**2, 4.0)], T0
        )
        ahead = np.array((0.4,))
        errors[float(t)] = float((bank.predict_positions(state, ahead) - truth.at(t + ahead))[0])
    assert state.motion is Motion.STOPPING
    assert state.x[4] == pytest.approx(-share * STOP, rel=0.12)
    late = [abs(error) for t, error in errors.items() if t > 1.45]
    assert max(late) < 0.003


def test_the_bank_never_grows_beyond_its_oldest_onset() -> None:
    state = BANK.initial(0.0)
    for k in range(1, 300):
        state = BANK.advance(state, measured_row(NOMINAL * k * T0), T0)
        assert len(state.changes.age) <= round(SETTINGS.longest_onset / T0)
        assert all(each.shape[-1] == len(state.changes.age) for each in arrays(state))
    assert float(state.changes.age.max()) <= SETTINGS.longest_onset + 1e-9
    assert (np.diff(state.changes.age) > 0.0).all()


@pytest.mark.parametrize("dt", [0.001, 0.002, 0.004, 0.012])
def test_a_shorter_cycle_has_no_more_hypotheses_than_one_of_4_ms(dt: float) -> None:
    onsets = onset_bank.begin(np.zeros(STATES), (0.0,))
    bank, longest = onset_bank.empty(STATES), 0.4
    for _ in range(round(2.0 * longest / dt)):
        bank = onset_bank.propagate(bank, onsets, np.eye(STATES), dt, longest)
    spacing = max(dt, 0.004)
    assert np.diff(bank.age) == pytest.approx(np.full(len(bank) - 1, spacing))
    assert len(bank) == round(longest / spacing)
    assert bank.age[0] <= spacing + 1e-9
    # Too young for evidence, each has the likelihood 1: the odds are then those of the time alone.
    odds = onset_bank.posterior(bank, onset_bank.AmplitudePrior(1.0, 1e-12)).odds
    assert odds == pytest.approx(math.log(len(bank) * spacing / 0.012), abs=1e-6)


@pytest.mark.parametrize("mean", [1.0, 0.0, -1e-9])
@pytest.mark.parametrize("least", [-math.inf, 1.45])
def test_one_hypothesis_has_the_posterior_of_a_bank(mean: float, least: float) -> None:
    prior = onset_bank.AmplitudePrior(mean, 0.3, least, odds=-3.7)
    for A, B, usual in itertools.product((0.0, 0.7, 913.0), (-31.0, 0.2, 1500.0), (0.1, 1.0)):
        sums = np.array(((A,), (B,), (0.2,), (0.0,), (usual,)))
        one = onset_bank.posterior(onset_bank.OnsetBank(np.zeros((STATES, 1)), sums), prior)
        # With a share of 1 it is computed as a bank.
        bank = onset_bank.OnsetBank(np.zeros((STATES, 1)), sums, np.ones(1))
        result = onset_bank.posterior(bank, prior)
        assert (one.odds, one.variance) == (result.odds, result.variance)
        assert one.weights == result.weights == 1.0
        assert one.amplitudes == result.amplitudes


@pytest.mark.parametrize("omegas", [(0.0,), (3.0, 9.0)])
@pytest.mark.parametrize("dt", [0.001, 0.002, 0.004])
def test_a_full_bank_leaves_out_old_onsets_and_keeps_their_weight(
    dt: float, omegas: tuple[float, ...]
) -> None:
    onsets = onset_bank.begin(np.zeros(STATES), omegas)
    bank, longest, most = onset_bank.empty(STATES), 1.5, 0
    for _ in range(round(2.0 * longest / dt)):
        bank = onset_bank.propagate(bank, onsets, np.eye(STATES), dt, longest)
        most = max(most, len(bank))
        ages = bank.age[:: len(omegas)]
        assert (np.diff(ages) <= np.maximum(0.06 * len(omegas) * ages[1:], 0.0041)).all()
    assert most == onset_bank.MOST // len(omegas) * len(omegas)
    assert (bank.omega.reshape(-1, len(omegas)) == omegas).all()
    assert 1.3 < ages[-1] <= longest
    odds = onset_bank.posterior(bank, onset_bank.AmplitudePrior(1.0, 1e-12)).odds
    assert odds == pytest.approx(math.log(len(omegas) * longest / 0.012), abs=0.15)


def measured_row(value: float) -> list[PositionMeasurement]:
    return [PositionMeasurement(Source.DISTANCE, value, 0.0, DEVIATION**2, NEVER)]


def arrays(state: BankState) -> list[Array]:
    return [state.changes.error, state.changes.A, state.changes.B]


def test_the_covariance_stays_symmetric_and_positive_through_a_stop_and_a_start() -> None:
    truth = Truth(6.0, ((0.5, -STOP), (3.0, 0.013)))
    bank = replace(BANK, bank=BankSettings(), fusion=FusionSettings())
    rng = np.random.default_rng(1)
    state = bank.initial(float(truth.at(-1.5)))
    motions = set()
    for t in np.arange(-1.5 + T0, 6.0, T0):
        value = float(truth.at(t)) + rng.normal(0.0, DEVIATION)
        state = bank.advance(
            state, [PositionMeasurement(Source.DISTANCE, value, 0.0, DEVIATION**2, 4.0)], T0
        )
        motions.add(state.motion)
        assert np.allclose(state.P, state.P.T, rtol=0.0, atol=1e-12)
        assert np.linalg.eigvalsh(0.5 * (state.P + state.P.T))[0] > -1e-12
    assert motions == {Motion.RUNNING, Motion.STOPPING, Motion.STANDING, Motion.STARTING}


# In contact: the force sensor sees the body, the distance sensor the conveyor.

CONTACT = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)


def in_contact(
    truth: Truth,
    push: Callable[[float], float],
    seconds: float,
    seed: int,
    pushed_s: float = -math.inf,
) -> list[tuple[float, str, str]]:
    """Events of a bank in contact whose body is pushed; the push starts at 0 s or later.

    Args:
        pushed_s: when another push was accepted [s].
    """
    rng = np.random.default_rng(seed)
    state = structs.replace(CONTACT.initial(float(truth.at(-1.5))), impulse_age=-1.5 - pushed_s)
    events = []
    for t in np.arange(-1.5 + T0, seconds, T0):
        state = CONTACT.advance(state, contact_rows(truth, push, float(t), rng), T0)
        events += [(float(t), kind, what) for kind, what in CONTACT.estimate(state).events]
    return events


def contact_rows(
    truth: Truth, push: Callable[[float], float], t: float, rng: np.random.Generator
) -> list[PositionMeasurement]:
    read = round((float(truth.at(t - 0.001)) + rng.normal(0.0, 0.00025)) * 1e3) / 1e3
    felt = float(truth.at(t - 0.006)) + push(t - 0.006) + rng.normal(0.0, TOUCH)
    return [
        PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0),
        PositionMeasurement(Source.TACTILE, felt, 0.006, TOUCH**2, 20.0),
    ]


@pytest.mark.parametrize("seed", range(3))
def test_an_accepted_impulse_keeps_all_onsets_and_what_denies_them(seed: int) -> None:
    """Without onsets, a stop began with the impulse, and braked faster for it: 305 N."""
    truth, rng = Truth(1.2, ((0.4, -STOP),), seed=seed), np.random.default_rng(seed)
    state = CONTACT.initial(float(truth.at(-1.5)))
    for t in np.arange(-1.5 + T0, 0.49, T0):
        state = CONTACT.advance(state, contact_rows(truth, lambda _: 0.0, float(t), rng), T0)
    pushed, prior = CONTACT._accept_impulse(state), CONTACT.impulse_prior
    banks = (state.changes, pushed.changes, PRIOR), (state.impulses, pushed.impulses, prior)
    for bank, kept, prior in banks:
        before, _ = onset_bank.likelihood_ratios(bank, prior)
        assert before.max() > 2.0
        assert before.min() < 0.0
        assert kept.shares is not None
        ratios, _ = onset_bank.likelihood_ratios(kept, prior)
        assert ratios + np.log(kept.shares) == pytest.approx(np.minimum(before, 0.0))
        assert kept.error == pytest.approx(bank.error)
        assert kept.age == pytest.approx(bank.age)


@pytest.mark.parametrize(("impulse_odds", "keeps"), [(2.0, False), (-2.0, True)])
def test_a_lost_force_leaves_no_support_for_what_was_rather_an_impulse(
    impulse_odds: float, keeps: bool
) -> None:
    """The impulse was forgotten with the force, and what it had shown became a stop: 350 N."""
    truth, rng = Truth(1.2, ((0.4, -STOP),), seed=0), np.random.default_rng(0)
    state = CONTACT.initial(float(truth.at(-1.5)))
    for t in np.arange(-1.5 + T0, 0.49, T0):
        state = CONTACT.advance(state, contact_rows(truth, lambda _: 0.0, float(t), rng), T0)
    lost = structs.replace(state, contact=False, impulse_odds=impulse_odds)
    before = onset_bank.posterior(state.changes, PRIOR).odds
    later = bank_filter.predict(CONTACT, lost, T0)
    assert len(later.impulses) == 0
    after = onset_bank.posterior(later.changes, PRIOR).odds
    assert (after > before - 1.0) is keeps
    assert keeps or after < 4.0


@pytest.mark.parametrize("seed", range(3))
def test_in_contact_a_stop_is_confirmed_next_to_the_hypothesis_of_a_push(seed: int) -> None:
    truth = Truth(1.0, ((0.4, -STOP),), seed=seed)
    events = in_contact(truth, lambda _: 0.0, 0.9, seed)
    confirmed = [t for t, kind, what in events if (kind, what) == ("stop", "confirmed")]
    assert len(confirmed) == 1
    assert 0.4 < confirmed[0] < 0.4 + 0.2


@pytest.mark.parametrize("size", [0.001, -0.002, 0.003])
@pytest.mark.parametrize("frequency_hz", [1.0, 2.0])
def test_a_push_of_the_body_is_not_taken_for_a_stop(size: float, frequency_hz: float) -> None:
    w = 2.0 * math.pi * frequency_hz

    def push(t: float) -> float:
        return size * math.exp(-0.1 * w * max(t, 0.0)) * math.sin(w * max(t, 0.0))

    events = in_contact(Truth(1.3, seed=5), push, 1.2, 5)
    assert not [t for t, kind, what in events if (kind, what) == ("stop", "confirmed")]


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize(("pushed_s", "count"), [(-math.inf, 1), (-1.4, 1), (-0.5, 0)])
def test_what_follows_a_push_too_soon_is_not_taken_for_another(
    pushed_s: float, count: int, seed: int
) -> None:
    w = 2.0 * math.pi * 1.5

    def push(t: float) -> float:
        late = max(t - 0.2, 0.0)
        return 0.002 * math.exp(-0.15 * w * late) * math.sin(w * late)

    events = in_contact(Truth(1.3, seed=seed), push, 0.7, seed, pushed_s)
    assert len([t for t, kind, what in events if (kind, what) == ("push", "confirmed")]) == count


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("size", [0.002, -0.002])
def test_a_push_too_soon_to_be_accepted_hides_no_stop(size: float, seed: int) -> None:
    """It explained the force of the stop: 0.26 s until that was confirmed."""
    w = 2.0 * math.pi * 1.5

    def push(t: float) -> float:
        late = max(t - 0.2, 0.0)
        return size * math.exp(-0.15 * w * late) * math.sin(w * late)

    events = in_contact(Truth(1.8, ((0.5, -STOP),), seed=seed), push, 1.0, seed, -0.5)
    confirmed = [t for t, kind, what in events if (kind, what) == ("stop", "confirmed")]
    assert len(confirmed) == 1
    assert 0.5 < confirmed[0] < 0.5 + 0.22


# A fine sensor: it sees the ripple, and a stop leaves its gate before anybody has perceived it.

FINE = 5.8e-5
SHARP = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), FINE)


def fine_row(truth: Truth, t: float, rng: np.random.Generator) -> list[PositionMeasurement]:
    read = round((float(truth.at(t - 0.001)) + rng.normal(0.0, 5e-5)) * 1e4) / 1e4
    return [PositionMeasurement(Source.DISTANCE, read, 0.001, FINE**2, 4.0)]


@pytest.mark.parametrize("seed", range(6))
def test_a_fine_sensor_lets_no_stop_out_of_its_gate_and_takes_no_ripple_for_one(seed: int) -> None:
    rng = np.random.default_rng(seed)
    onset = 6.0 + 0.002 * seed
    truth = Truth(onset + 0.4, ((onset, -STOP),), seed=seed)
    state = SHARP.initial(float(truth.at(-1.5)))
    events = []
    for t in np.arange(-1.5 + T0, onset + 0.35, T0):
        state = SHARP.advance(state, fine_row(truth, float(t), rng), T0)
        events += [(float(t), *event) for event in state.events]
    confirmed = [t for t, kind, what in events if (kind, what) == ("stop", "confirmed")]
    assert len(confirmed) == 1
    assert onset < confirmed[0] < onset + 0.15


def test_a_stop_that_does_not_slow_the_conveyor_is_taken_back() -> None:
    truth = Truth(4.0, ripple=0.0)
    rng = np.random.default_rng(2)
    state = SHARP.initial(float(truth.at(-1.5)))
    times = np.arange(-1.5 + T0, 3.5, T0)
    for t in times[:150]:
        state = SHARP.advance(state, fine_row(truth, float(t), rng), T0)
    braking = state.x.copy()
    braking[4] = -STOP
    P = state.P.copy()
    P[4, 4] = (0.15 * STOP) ** 2
    state = structs.replace(state, x=braking, P=P, motion=Motion.STOPPING, class_age=0.0)
    events = []
    for t in times[150:]:
        state = SHARP.advance(state, fine_row(truth, float(t), rng), T0)
        events += state.events
    assert ("stop", "cancelled") in events
    assert state.motion is Motion.RUNNING
    assert state.x[1] + state.x[2] == pytest.approx(NOMINAL, abs=0.002)


def test_a_stop_declared_within_a_start_becomes_a_start_again() -> None:
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng, begin, acceleration = np.random.default_rng(3), 2.0, 0.06
    state, classes = bank.initial(0.0), []
    for k in range(1, round(4.0 / T0)):
        late = max(k * T0 - begin, 0.0)
        way = 0.5 * acceleration * late * late + rng.normal(0.0, DEVIATION)
        state = bank.advance(
            state, [PositionMeasurement(Source.DISTANCE, way, 0.0, DEVIATION**2, 4.0)], T0
        )
        if abs(late - 0.7) < 0.5 * T0:
            assert state.motion is Motion.STARTING
            x, P = state.x.copy(), state.P.copy()
            x[ACCELERATION], P[ACCELERATION, ACCELERATION] = -0.104, 0.05**2
            state = structs.replace(state, x=x, P=P, motion=Motion.STOPPING, class_age=0.0)
        if late > 0.7:
            classes.append(state.motion)
        if late > 1.4 and acceleration * late < 0.9 * NOMINAL:
            assert float(state.x[V]) == pytest.approx(acceleration * late, abs=0.006)
    # Its speed says so, before the acceleration is known again.
    assert [motion for motion, _ in itertools.groupby(classes)] == [
        Motion.STOPPING,
        Motion.STARTING,
        Motion.RUNNING,
    ]


def test_a_stop_declared_within_a_slow_start_is_taken_back_long_before_it_is_fast() -> None:
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng, acceleration, declared = np.random.default_rng(3), 0.014, 2.0
    state, stopping = bank.initial(0.0), 0.0
    for k in range(1, round(5.0 / T0)):
        late = max(k * T0 - 1.0, 0.0)
        way = 0.5 * acceleration * late * late + rng.normal(0.0, DEVIATION)
        state = bank.advance(
            state, [PositionMeasurement(Source.DISTANCE, way, 0.0, DEVIATION**2, 4.0)], T0
        )
        if abs(late - declared) < 0.5 * T0:
            state = structs.replace(state, motion=Motion.STOPPING, class_age=0.0)
        stopping += T0 if state.motion is Motion.STOPPING else 0.0
    assert stopping < 0.3
    assert state.motion is Motion.STARTING
    assert float(state.x[V]) == pytest.approx(acceleration * late, abs=0.006)


@pytest.mark.parametrize("share", [0.75, 1.25])
def test_a_stop_at_the_edge_of_what_is_known_of_it_is_not_taken_back(share: float) -> None:
    truth = Truth(3.0, ((1.0, -share * STOP),))
    rng = np.random.default_rng(4)
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    state = bank.initial(float(truth.at(-1.5)))
    events = []
    for t in np.arange(-1.5 + T0, 2.9, T0):
        read = round((float(truth.at(t - 0.001)) + rng.normal(0.0, 0.00025)) * 1e3) / 1e3
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0)]
        state = bank.advance(state, rows, T0)
        events += state.events
    assert events.count(("stop", "confirmed")) == 1
    assert ("stop", "cancelled") not in events[events.index(("stop", "confirmed")) :]
    assert state.motion is Motion.STANDING


def test_in_contact_little_evidence_moves_the_prediction_less_than_bayes_would() -> None:
    """A quiet line is not followed as if it braked a little; a stop is as soon as it shows."""
    shares = {}
    for caution in (1.0, BankSettings().contact_caution):
        settings = BankSettings(contact_caution=caution)
        bank = BankClassifier(ConveyorClasses(), FusionSettings(), settings, DEVIATION)
        state = structs.replace(
            bank.initial(0.0),
            contact=True,
            is_keen=True,
            changes=onset_bank.begin(np.zeros(STATES), (0.0,)),
        )
        shares[caution] = [
            bank_prediction.hypothesis_weights(
                bank,
                structs.replace(
                    state,
                    change=onset_bank.OnsetPosterior(odds, np.ones(1), np.ones(1)),
                    change_odds=odds,
                ),
            )[0]
            for odds in (1.2, 7.0)
        ]
    bayes, careful = shares.values()
    assert careful[0] < 0.02 < bayes[0]
    assert careful[1] > bayes[1] > 0.9


@pytest.mark.parametrize("seed", range(3))
def test_a_stop_in_a_start_that_followed_a_stop_is_confirmed_by_its_own_readings(seed: int) -> None:
    """The braking before the start was taken for a steady motion, and denied the stop: 248 N."""
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    stops_s = 5.8
    times = np.arange(0.0, stops_s + 0.3, 1e-3)
    ramps = ((times > 5.0) & (times < 5.218), (times >= 5.218) & (times < stops_s))
    accelerations = -0.218 * ramps[0] + 0.062 * ramps[1] - 0.104 * (times >= stops_s)
    way = np.cumsum(NOMINAL + np.cumsum(accelerations) * 1e-3) * 1e-3
    rng, state, stopped_s = np.random.default_rng(seed), bank.initial(0.0), math.inf
    for t in np.arange(T0, stops_s + 0.25, T0):
        seen, felt = np.interp((t - 0.006, t - 0.011), times, way)
        read = round((float(seen) + rng.normal(0.0, 2.5e-4)) * 1e3) / 1e3
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.006, DEVIATION**2, 4.0)]
        if t > 5.1:
            held = float(felt) + rng.normal(0.0, 3e-5)
            rows.append(PositionMeasurement(Source.TACTILE, held, 0.011, 4e-5**2, 20.0))
        state = bank.advance(state, rows, T0)
        if t > stops_s and ("stop", "confirmed") in state.events:
            stopped_s = min(stopped_s, float(t))
    assert stopped_s - stops_s < 0.16


@pytest.mark.parametrize(("odds", "motion"), [(10.0, Motion.STOPPING), (30.0, Motion.STARTING)])
def test_an_impulse_hides_no_change_within_a_ramp_that_the_distance_sensor_shows(
    monkeypatch: pytest.MonkeyPatch, odds: float, motion: Motion
) -> None:
    """An impulse explains the force of a start within a stop, but not the readings."""
    bank = BankClassifier(ConveyorClasses(), FUSION, BankSettings(), DEVIATION)
    monkeypatch.setattr(BankClassifier, "_distance_odds", lambda *_: odds)
    shown = onset_bank.begin(np.zeros(STATES), (0.0,), 0.1)
    swings = onset_bank.begin(np.zeros(STATES), (10.0,), 0.1)
    shown.sums[:2], swings.sums[0], swings.sums[1] = 200.0, 4e7, 2e5
    state = structs.replace(
        bank.initial(0.0), motion=Motion.STOPPING, contact=True, changes=shown, impulses=swings
    )
    assert bank._decide(state).motion is motion


def test_the_readings_of_a_start_hide_no_stop_after_it() -> None:
    """They are no steady motion: as one they denied a stop in contact with odds of -165."""
    bank = BankClassifier(ConveyorClasses(), FUSION, BankSettings(), DEVIATION)
    ages = np.arange(0.8, 0.0, -T0)
    started, stopped = np.minimum(0.3 - ages, 0.0), np.maximum(0.2 - ages, 0.0)
    way = -NOMINAL * ages + 0.0165 * started**2 - 0.5 * STOP * stopped**2
    state = structs.replace(
        bank.initial(0.0),
        class_age=0.3,
        within_ramp=True,
        readings=np.array((ages, way)),
        changes=onset_bank.begin(np.zeros(STATES), (0.0,), 0.2),
        change=onset_bank.OnsetPosterior(10.0, np.ones(1), np.ones(1), 0.0225),
    )
    odds = [
        bank._distance_odds(structs.replace(state, within_ramp=within)) for within in (True, False)
    ]
    assert odds[0] is not None
    assert odds[1] is not None
    assert odds[0] > 5.0
    assert odds[1] < -5.0


@pytest.mark.parametrize("strength", [0.104, 0.128])
def test_a_stop_that_was_taken_as_a_faster_one_is_no_start(strength: float) -> None:
    """Against a ramp that strong the readings of a usual stop showed a start."""
    bank = BankClassifier(ConveyorClasses(), FUSION, BankSettings(), DEVIATION)
    ages = np.arange(0.99, 0.0, -T0)
    way = -NOMINAL * ages - 0.5 * strength * np.maximum(0.24 - ages, 0.0) ** 2
    x = bank.initial(0.0).x.copy()
    x[ACCELERATION] = -0.27 + 2.0 * bank.changes[Motion.STOPPING]
    state = structs.replace(
        bank.initial(0.0),
        x=x,
        motion=Motion.STOPPING,
        class_age=0.24,
        readings=np.array((ages, way)),
        changes=onset_bank.begin(np.zeros(STATES), (0.0,), 0.2),
        change=onset_bank.OnsetPosterior(100.0, np.ones(1), np.array((2.0,)), 0.7),
    )
    odds = bank._distance_odds(state)
    assert odds is not None
    assert odds < -1.0


def coasting(tau: float, seconds: float) -> tuple[Array, Array]:
    """Times and positions of a stop at 1 s whose last part fades exponentially."""
    times = np.arange(-1.0, seconds, 0.001)
    age, fast = np.maximum(times - 1.0, 0.0), NOMINAL / STOP - tau
    ramp = NOMINAL - STOP * age
    tail = STOP * tau * np.exp(-np.maximum(age - fast, 0.0) / tau)
    return times, np.cumsum(np.where(age < fast, ramp, tail)) * 0.001


def followed(times: Array, positions: Array, *, sway: float = 0.0) -> list[BankState]:
    """States of a bank in contact whose body swings by ``sway`` [m] at 0.9 Hz from 4 s on.

    No swing is explained by an impulse: only the distance sensor tells it from a start.
    """
    impulse = ImpulseSettings(confirmed=NEVER) if sway else ImpulseSettings()
    bank = BankClassifier(
        ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION, impulse=impulse
    )
    rng = np.random.default_rng(4)
    state, states = bank.initial(float(positions[0])), []
    for t in np.arange(times[0] + 0.2, times[-1], T0):
        at = float(np.interp(t - 0.001, times, positions))
        swung = sway * (1.0 - math.cos(2.0 * math.pi * 0.9 * max(t - 4.0, 0.0)))
        far, near = rng.normal(0.0, DEVIATION), rng.normal(0.0, 5e-5)
        rows = [
            PositionMeasurement(Source.DISTANCE, at + far, 0.001, DEVIATION**2, 4.0),
            PositionMeasurement(Source.TACTILE, at + near + swung, 0.001, 25e-10, 20.0),
        ]
        state = bank.advance(state, rows, T0)
        states.append(state)
    return states


@pytest.mark.parametrize("tau", [0.1, 0.3])
def test_a_stop_that_coasts_out_ends_and_is_no_start(tau: float) -> None:
    states = followed(*coasting(tau, 5.0))
    events = [event for state in states for event in state.events]
    assert ("stop", "confirmed") in events
    assert ("start", "confirmed") not in events
    assert states[-1].motion is Motion.STANDING
    assert all(float(state.x[1]) >= -1e-3 for state in states)


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("sway", [0.0002, 0.0005, 0.001])
def test_a_body_that_swings_is_no_start_as_long_as_the_conveyor_stands(sway: float) -> None:
    states = followed(*coasting(0.05, 10.0), sway=sway)
    assert ("start", "confirmed") not in [event for state in states for event in state.events]
    assert states[-1].motion is Motion.STANDING


def pushed_on(support: float, monkeypatch: pytest.MonkeyPatch) -> list[tuple[str, str]]:
    """Events of a stop during which the body is pushed along as if the conveyor went on."""
    monkeypatch.setitem(classifier_bank.SUPPORT, "start", support)
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    truth, rng = Truth(1.5, ((0.4, -STOP),), seed=3), np.random.default_rng(3)
    state, events = bank.initial(float(truth.at(-1.5))), []
    for t in np.arange(-1.5 + T0, 1.2, T0):
        pushed = 0.5 * (STOP + START) * max(min(t, 1.0) - 0.75, 0.0) ** 2
        seen = float(truth.at(t - 0.006)) + pushed + rng.normal(0.0, 5e-5)
        read = float(truth.at(t - 0.001)) + rng.normal(0.0, DEVIATION)
        rows = [
            PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0),
            PositionMeasurement(Source.CAMERA, seen, 0.006, 25e-10, 20.0),
        ]
        state = bank.advance(state, rows, T0)
        events += state.events
    return events


def test_a_body_pushed_while_the_conveyor_brakes_is_no_start(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = pushed_on(classifier_bank.SUPPORT["start"], monkeypatch)
    assert ("stop", "confirmed") in asked
    assert ("start", "confirmed") not in asked
    assert ("start", "confirmed") in pushed_on(-math.inf, monkeypatch), "else nothing is tested"


@pytest.mark.parametrize("seed", range(3))
def test_the_distance_sensor_supports_a_start_while_the_conveyor_brakes(seed: int) -> None:
    """The null filter follows a felt start: the ramp before it had no deceleration left, 174 N."""
    truth = Truth(1.5, ((0.2, -STOP), (0.6, START)), seed=seed)
    events = in_contact(truth, lambda _: 0.0, 1.0, seed)
    confirmed = [t for t, kind, what in events if (kind, what) == ("start", "confirmed")]
    assert len(confirmed) == 1
    assert 0.6 < confirmed[0] < 0.6 + 0.25


def test_a_speed_that_is_left_when_a_stop_ends_dies_out() -> None:
    states = followed(*coasting(0.1, 3.0))
    before = [state for state in states if state.motion is Motion.STOPPING][-1]
    left = structs.replace(before, x=before.x + np.eye(STATES)[1] * 0.003, guide=None)
    standing = bank_filter.enter_standing(BANK, left)
    assert standing.x[1] == 0.0
    assert standing.x[2] == pytest.approx(left.x[1] + left.x[2])
    ahead = bank_prediction.predict_positions(BANK, standing, np.array((0.0, 0.2, 2.0, 4.0)))
    assert ahead[3] - ahead[2] < 1e-6 < ahead[1] - ahead[0]


@pytest.mark.parametrize("seed", range(3))
def test_a_start_that_hesitates_in_contact_is_no_stop(seed: int) -> None:
    """A drive that starts loses 5 mm/s within 0.08 s: a stop loses 8 mm/s."""
    truth = Truth(9.0, ((0.5, -STOP), (3.0, START), (8.0, HESITATES), (8.08, START)), seed=seed)
    events = in_contact(truth, lambda _: 0.0, 8.6, seed)
    stops = [t for t, kind, what in events if (kind, what) == ("stop", "confirmed")]
    assert len(stops) == 1
    assert stops[0] < 1.0


def test_a_stop_that_no_reading_confirms_ends_and_is_not_forgotten() -> None:
    steps = measured(Truth(1.5, ((0.95, -STOP),)), seed=3)
    state = BANK.initial(steps[0][0].value)
    for rows in steps[1:]:
        state = BANK.advance(state, rows[:1], T0)
        if bank_prediction.hypothesis_weights(BANK, state)[0] > 0.99:
            break
    assert state.motion is Motion.RUNNING
    now, places = np.zeros(1), []
    for _ in range(round(2.5 / T0)):
        state = BANK.advance(state, [], T0)
        places.append(float(BANK.predict_positions(state, now)[0]))
    assert np.diff(places).min() > -1e-4
    assert places[-1] - places[0] < 0.6 * NOMINAL**2 / STOP
