"""A body that sways is no conveyor that starts or stops, and it is followed."""

import math
from dataclasses import replace

import numpy as np
import pytest
from conveyor_truth import DEVIATION, NOMINAL, STOP, T0, Sensor, Truth
from msgspec import structs

from linemate.daemon.core.tracking.classifiers.bank_model import (
    GAIN,
    IMPULSE_QUADRATURE,
    SWAY,
    SWAY_QUADRATURE,
    BankState,
)
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.classifiers.sway_filter import touched
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import (
    BankSettings,
    FusionSettings,
    RippleSettings,
    SwaySettings,
)
from linemate.daemon.core.tracking.task import ConveyorClasses

BANK = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
DELAY = 0.1


def sway_of(truth: Truth, frequency_hz: float, gain: float, free: float) -> np.ndarray:
    """Sway on the truth's grid: forced by the conveyor, and free from the start."""
    h = float(truth.times[1] - truth.times[0])
    a = np.gradient(np.convolve(truth.speeds, np.full(9, 1.0 / 9.0), "same"), h)
    a[:20] = a[-20:] = 0.0
    a[np.abs(a) < 0.005] = 0.0
    w = math.tau * frequency_hz
    turn = np.exp(complex(-0.01, 1.0) * w * h)
    z, sway = complex(free, 0.0), np.empty(len(a))
    for i, each in enumerate(a):
        z = turn * z + 1j * gain * each * h / w
        sway[i] = z.real
    return sway


def run(
    truth: Truth,
    sway: np.ndarray,
    seconds: float,
    *,
    bank: BankClassifier = BANK,
    contact_from: float = math.inf,
    pushed: float = 0.0,
) -> tuple[BankState, list[tuple[float, str, str]], list[float]]:
    """The classifier on a body that sways: state, events, and errors of the sway."""
    rng = np.random.default_rng(7)
    events, errors, state = [], [], None
    readings = Sensor(seed=3).read(truth, np.arange(round((seconds + 2.0) / T0)) * T0 - 2.0)
    for k, reading in enumerate(readings):
        t = -2.0 + k * T0
        if state is None:
            state = bank.initial(float(reading))
            continue
        rows = [PositionMeasurement(Source.DISTANCE, float(reading), 0.001, DEVIATION**2, 4.0)]
        body = np.interp((t - DELAY, t), truth.times, truth.positions + sway)
        if t > contact_from:
            value = body[1] + rng.normal(0.0, 5e-5)
            felt = PositionMeasurement(Source.TACTILE, value, 0.0, 25e-10, 20.0, pushed=pushed)
            rows.append(felt)
        elif k % 2:
            value = body[0] + rng.normal(0.0, 5e-4)
            rows.append(PositionMeasurement(Source.CAMERA, value, DELAY, 25e-8, 5.0))
        state = bank.advance(state, rows, T0)
        events += [(t, *event) for event in state.events]
        errors.append(float(state.x[SWAY] - np.interp(t, truth.times, sway)))
    assert state is not None
    return state, events, errors


def confirmed(events: list[tuple[float, str, str]]) -> list[str]:
    return [what for _, what, how in events if how == "confirmed"]


def driven_by_a_chain(seconds: float) -> BankState:
    """A body of 1.2 Hz, identified 1.5 % too high, that a chain drives at 1.06 Hz until a stop."""
    settings = SwaySettings(
        frequency_hz=1.218, gain=1.0, gain_deviation=0.05, spread=0.02, damping=0.01
    )
    truth = Truth(9.0, ((4.0, -STOP),), ripple=1e-5)
    chain = 0.0012 * np.cos(math.tau * 1.06 * truth.times) * (truth.times < 4.0)
    # The driven sway becomes a free one where the chain stands.
    after = np.maximum(truth.times - 4.0, 0.0) * math.tau * 1.2
    free = 0.0012 * np.cos(math.tau * 1.06 * 4.0 + after) * (truth.times >= 4.0)
    sway = sway_of(truth, 1.2, 1.0, 0.0) + chain + free * np.exp(-0.01 * after)
    return run(truth, sway, seconds, bank=replace(BANK, sway=settings))[0]


def test_a_chain_that_drives_the_sway_does_not_change_its_identified_frequency() -> None:
    state = driven_by_a_chain(3.9)
    assert state.motion is Motion.RUNNING
    assert state.sway_omega == pytest.approx(math.tau * 1.218, rel=1e-9)


def test_a_free_sway_after_the_stop_refines_the_identified_frequency() -> None:
    state = driven_by_a_chain(8.5)
    assert state.motion is Motion.STANDING
    assert state.sway_omega == pytest.approx(math.tau * 1.2, rel=0.004)


@pytest.mark.parametrize("frequency_hz", [0.5, 0.62, 1.0, 1.5])
def test_an_unknown_pendulum_is_followed_after_its_first_stop(frequency_hz: float) -> None:
    truth = Truth(5.0, ((1.0, -STOP),), ripple=1e-5)
    state, events, errors = run(truth, sway_of(truth, frequency_hz, 1.0, 0.0), 5.0)
    assert confirmed(events) == ["stop"]
    assert state.motion is Motion.STANDING
    assert state.sway_omega == pytest.approx(math.tau * frequency_hz, rel=0.04)
    assert state.x[GAIN] == pytest.approx(1.0, abs=0.3)
    tail = np.array(errors[-round(1.5 / T0) :])
    assert float(np.sqrt(np.mean(tail**2))) < 4e-4


def test_a_known_pendulum_is_right_while_nothing_sees_it() -> None:
    known = replace(BANK, sway=SwaySettings(frequency_hz=0.62, gain=1.0, gain_deviation=0.05))
    truth = Truth(1.4, ((0.2, -STOP),), ripple=1e-5)
    sway = sway_of(truth, 0.62, 1.0, 0.0)
    blind = replace(truth)
    rows_until = 0.0
    state = None
    readings = Sensor(seed=3).read(blind, np.arange(round(3.2 / T0)) * T0 - 2.0)
    rng = np.random.default_rng(2)
    for k, reading in enumerate(readings):
        t = -2.0 + k * T0
        if state is None:
            state = known.initial(float(reading))
            continue
        rows = [PositionMeasurement(Source.DISTANCE, float(reading), 0.001, DEVIATION**2, 4.0)]
        if k % 2 and t < rows_until:
            value = float(np.interp(t - DELAY, truth.times, truth.positions + sway))
            value += rng.normal(0.0, 5e-4)
            rows.append(PositionMeasurement(Source.CAMERA, value, DELAY, 25e-8, 5.0))
        state = known.advance(state, rows, T0)
    assert state is not None
    true = float(np.interp(1.2 - T0, truth.times, sway))
    assert true > 0.009
    assert float(state.x[SWAY]) == pytest.approx(true, abs=1.2e-3)
    ahead = np.array((0.0, 0.15))
    places = known.predict_positions(state, ahead)
    body = np.interp(1.2 - T0 + ahead, truth.times, truth.positions + sway)
    assert places[1] - places[0] == pytest.approx(body[1] - body[0], abs=6e-4)


@pytest.mark.row
@pytest.mark.long
@pytest.mark.parametrize("in_contact", [False, True])
@pytest.mark.parametrize("frequency_hz", [0.4, 0.7, 1.2, 2.0, 4.0])
def test_a_sway_while_standing_is_no_start(frequency_hz: float, in_contact: bool) -> None:
    truth = Truth(12.0, speed=0.0, ripple=0.0)
    begins = 0.0 if in_contact else math.inf
    sway = sway_of(truth, frequency_hz, 0.0, 0.0025)
    state, events, _ = run(truth, sway, 12.0, contact_from=begins)
    assert "start" not in confirmed(events)
    assert "stop" not in confirmed(events)
    assert confirmed(events).count("push") <= 4
    assert state.motion is Motion.STANDING


def test_a_swing_does_not_hide_a_stop() -> None:
    truth = Truth(3.0, ((1.0, -STOP),), ripple=1e-5)
    _, events, _ = run(truth, sway_of(truth, 1.2, 0.0, 0.0036), 3.0)
    stops = [t for t, what, how in events if (what, how) == ("stop", "confirmed")]
    assert len(stops) == 1
    assert 1.0 < stops[0] < 1.35


def test_without_a_sway_nothing_is_followed() -> None:
    truth = Truth(8.0, ((3.0, -STOP),), ripple=1e-5)
    state, events, _ = run(truth, np.zeros(len(truth.times)), 8.0)
    assert state.sway_omega == 0.0
    assert confirmed(events) == ["stop"]
    assert not np.any(state.P[SWAY:])


def test_a_start_is_confirmed_though_the_body_lags_behind() -> None:
    truth = Truth(6.0, ((0.0, 0.013),), speed=0.0, ripple=0.0)
    known = replace(BANK, sway=SwaySettings(frequency_hz=0.62, gain=1.0, gain_deviation=0.05))
    sway = sway_of(truth, 0.62, 1.0, 0.0)
    state, events, _ = run(truth, sway, 2.5, bank=known, contact_from=-1.5)
    starts = [t for t, what, how in events if (what, how) == ("start", "confirmed")]
    assert len(starts) == 1
    assert starts[0] < 0.7
    assert state.motion is Motion.STARTING
    assert NOMINAL > float(state.x[1]) > 0.02


@pytest.mark.parametrize(
    ("sway", "gain", "frequency_hz"),
    [
        (SwaySettings(), 1.0, 0.35),
        (SwaySettings(gain_deviation=0.004), 0.004, 0.35),
        (SwaySettings(gain_deviation=0.1, range_hz=(0.5, 3.0)), 0.1, 0.5),
        (SwaySettings(frequency_hz=0.62, gain=1.0, gain_deviation=0.05), 0.2011, 0.62),
        (SwaySettings(frequency_hz=5.0, gain=1.0, gain_deviation=0.05), 1.0012, 5.0),
        (SwaySettings(is_on=False, frequency_hz=0.62, gain=0.8, gain_deviation=0.6), 1.0, 0.62),
    ],
)
def test_the_sway_that_is_not_known_follows_from_the_deviation_of_the_gain(
    sway: SwaySettings, gain: float, frequency_hz: float
) -> None:
    """The largest displacement of an undamped body is ``2 g a / w^2``, here with a = 1 m/s^2.

    An identified sway is also uncertain by 0.05 s of the ramp's end, at most by all of it:
    hypot(0.05, 2 pi 0.62 x 0.05) = 0.2011, hypot(0.05, 1) = 1.0012.
    """
    bank = replace(BANK, sway=sway)
    unknown = bank.estimate(bank.initial(0.0)).unknown_sway
    times = np.linspace(0.0, 4.0, 4001)
    omega = math.tau * frequency_hz
    response = gain * (1.0 - np.cos(omega * times)) / omega**2
    known = sway.is_on and sway.frequency_hz > 0.0
    assert unknown == pytest.approx(response.max(), rel=0.01 if known else 1e-3)


def test_a_gain_that_no_recording_shows_counts_more_than_its_deviation_where_it_may_harm() -> None:
    state = BANK.initial(0.0)
    P, omega = state.P.copy(), math.tau * 1.2
    P[GAIN, GAIN] = 0.2**2
    found = structs.replace(state, P=P, sway_omega=omega)
    assert BANK.estimate(found).unknown_sway == pytest.approx(2.0 * 0.5 / omega**2)


@pytest.mark.long
@pytest.mark.parametrize("late_s", [0.0, 0.15])
def test_a_sway_that_the_tools_force_changes_is_no_push(late_s: float) -> None:
    """A touch drags at a body that sways: its amplitude changes by half within 0.2 s."""
    truth = Truth(9.0, (), ripple=1e-5)
    sway = sway_of(truth, 1.2, 0.0, 0.0015)
    touches = 5.0
    h = float(truth.times[1] - truth.times[0])
    dragged, w = np.zeros(len(sway)), math.tau * 1.2
    force = np.abs(truth.times - touches - 0.1 - late_s) < 0.1
    z = 0j
    for i, on in enumerate(force):
        z = np.exp(complex(-0.01, 1.0) * w * h) * z - 1j * (40.0 / 900.0 if on else 0.0) * h / w
        dragged[i] = z.real
    known = SwaySettings(frequency_hz=1.2, gain=1.0, gain_deviation=0.05)
    for driven, expected in ((known.driven, []), (0.0, ["push"])):
        bank = replace(BANK, sway=replace(known, driven=driven))
        _, events, _ = run(truth, sway + dragged, 8.0, bank=bank, contact_from=touches)
        assert confirmed(events)[:1] == expected


def test_a_sway_seen_before_the_first_stop_is_predicted_as_the_stop_excites_it() -> None:
    """How strongly a stop excites it is not known yet: what is carried sways as a pendulum does."""
    truth = Truth(9.0, ((5.0, -STOP),), ripple=1e-5)
    sway = sway_of(truth, 1.2, 1.0, 0.002)
    rng, state, worst = np.random.default_rng(7), None, 0.0
    readings = Sensor(seed=3).read(truth, np.arange(round(7.4 / T0)) * T0 - 2.0)
    for k, reading in enumerate(readings):
        t = -2.0 + k * T0
        if state is None:
            state = BANK.initial(float(reading))
            continue
        rows = [PositionMeasurement(Source.DISTANCE, float(reading), 0.001, DEVIATION**2, 4.0)]
        if k % 2:
            body = float(np.interp(t - DELAY, truth.times, truth.positions + sway))
            value = body + rng.normal(0.0, 3e-4)
            rows.append(PositionMeasurement(Source.CAMERA, value, DELAY, 9e-8, 5.0))
        state = BANK.advance(state, rows, T0)
        if t > 5.0 and state.motion is Motion.STOPPING:
            later = float(BANK.predict_positions(state, np.array([0.25]))[0])
            true = float(np.interp(t + 0.25, truth.times, truth.positions + sway))
            worst = max(worst, abs(later - true))
    assert state is not None
    assert state.sway_omega == pytest.approx(math.tau * 1.2, rel=0.05)
    assert worst < 0.002


@pytest.mark.parametrize("seed", [1, 2, 3, 4])
def test_a_chain_that_drives_the_body_shows_how_a_stop_will_do_it(seed: int) -> None:
    """The camera sees the body for 3.5 s, and nothing for 1.5 s before the stop and in it."""
    chain_hz, chain, seen, stops = 1.06, 0.0002, (1.0, 4.5), 6.0
    wide = RippleSettings(spread=0.1, deviation=0.0001, walk=0.00002, pace=0.004)
    bank = replace(BANK, ripple=wide)
    plain = Truth(8.0, ((stops, -STOP),), ripple=1e-5)
    unit = plain.positions + chain * np.sin(math.tau * chain_hz * plain.positions / NOMINAL)
    h, w = float(plain.times[1] - plain.times[0]), math.tau * 1.2
    turn, z, body = np.exp(complex(-0.02, 1.0) * w * h), 0j, unit.copy()
    for i, blow in enumerate(np.diff(np.diff(unit)), 1):
        z = turn * z + 1j * blow / h / w
        body[i] += z.real
    rng, state, worst = np.random.default_rng(seed), bank.initial(float(unit[0])), 0.0
    for k in range(1, round((stops + 1.0 + 2.0) / T0)):
        t = -2.0 + k * T0
        read = float(np.interp(t - 0.001, plain.times, unit)) + rng.normal(0.0, DEVIATION)
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0)]
        if k % 3 == 0 and seen[0] < t < seen[1]:
            value = float(np.interp(t - DELAY, plain.times, body)) + rng.normal(0.0, 8e-4)
            rows.append(PositionMeasurement(Source.CAMERA, value, DELAY, 64e-8, 5.0))
        state = bank.advance(state, rows, T0)
        if t > stops + 0.3:
            sway = np.interp(t, plain.times, body - unit)
            worst = max(worst, abs(float(state.x[SWAY] - sway)))
    assert state.sway_omega == pytest.approx(w, rel=0.05)
    assert state.x[GAIN] == pytest.approx(1.0, abs=0.25)
    assert worst < 0.0016


def test_a_known_sway_that_nothing_sees_is_as_uncertain_as_it_may_be_wrong() -> None:
    """The camera is blind for 2 s before a touch, and the line runs."""
    settings = SwaySettings(
        frequency_hz=1.218, gain=1.0, gain_deviation=0.05, spread=0.02, damping=0.01
    )
    bank, truth = replace(BANK, sway=settings), Truth(9.0, (), ripple=1e-5)
    sway, seen_s, blind_s = sway_of(truth, 1.2, 0.0, 0.003), 4.0, 2.0
    state, _, _ = run(truth, sway, seen_s, bank=bank)
    t = seen_s - T0
    for _ in range(round(blind_s / T0)):
        t += T0
        value = float(np.interp(t - 0.001, truth.times, truth.positions))
        rows = [PositionMeasurement(Source.DISTANCE, value, 0.001, DEVIATION**2, 4.0)]
        state = bank.advance(state, rows, T0)
    error = float(state.x[SWAY] - np.interp(t, truth.times, sway))
    sigma = math.sqrt(float(state.P[SWAY, SWAY]))
    assert abs(error) < 2.5 * sigma
    assert sigma < 0.0007


PUSHED = 0.018  # by bolts that press along the line with 30 N [m/s]


def test_a_body_that_bolts_have_pushed_before_the_touch_is_nothing_new() -> None:
    """A body of 665 kg left with 10 mm/s: that was a stop, and the tool pulled with 393 N."""
    truth = Truth(6.0, (), ripple=1e-5)
    late = np.maximum(truth.times - 3.85, 0.0)
    sway = -0.0024 * np.sin(math.tau * 0.69 * late)
    known, unknown = (
        [
            t
            for t, _, how in run(truth, sway, 4.4, contact_from=4.0, pushed=each)[1]
            if how == "confirmed"
        ]
        for each in (PUSHED, 0.0)
    )
    assert min(unknown) < 4.12
    assert min(known, default=math.inf) > 4.15


def test_a_stop_right_after_such_a_touch_is_confirmed_as_soon() -> None:
    truth, times = Truth(6.0, ((4.1, -STOP),), ripple=1e-5), []
    for pushed in (0.0, PUSHED):
        events = run(truth, np.zeros(len(truth.times)), 5.0, contact_from=4.0, pushed=pushed)[1]
        times += [t for t, what, how in events if (what, how) == ("stop", "confirmed")]
    assert len(times) == 2
    assert times[1] < times[0] + 0.1


@pytest.mark.parametrize("omega", [0.0, 4.0])
def test_the_speed_that_bolts_gave_a_body_widens_its_sway_or_that_of_an_impulse(
    omega: float,
) -> None:
    state = structs.replace(BANK.initial(0.0), sway_omega=omega)
    change = touched(state, 0.02).P - touched(state).P
    of_speed = SWAY_QUADRATURE if omega else IMPULSE_QUADRATURE
    expected = np.zeros_like(change)
    expected[of_speed, of_speed] = (0.02 / (omega or state.impulse_omega)) ** 2
    assert change == pytest.approx(expected)
