"""The regressions find the sway of a body that hangs from a conveyor."""

import cmath
import math
from dataclasses import replace

import numpy as np
import pytest
from msgspec import structs
from scipy.integrate import solve_ivp

from linemate.daemon.core.tracking.classifiers import sway_bank
from linemate.daemon.core.tracking.classifiers.sway_bank import SwayFit
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import SwaySettings

SETTINGS = SwaySettings()
T0 = 0.012
BRAKE = -0.104
DELAY = 0.1
SIGMA, UNIT_SIGMA = 0.0005, 0.00038


def swayed(frequency_hz: float, gain: float, free: float, times: np.ndarray) -> np.ndarray:
    """Sway of a pendulum whose conveyor brakes for a second from t = 0 on, by integration."""
    w, zeta = math.tau * frequency_hz, SETTINGS.damping

    def slope(t: float, z: np.ndarray) -> tuple[float, float]:
        a = BRAKE if 0.0 <= t < 1.0 else 0.0
        return z[1], -2.0 * zeta * w * z[1] - w * w * z[0] - gain * a

    solved = solve_ivp(
        slope, (times[0], times[-1]), (free, 0.0), t_eval=times, max_step=0.005, rtol=1e-8
    )
    return np.asarray(solved.y[0])


def followed(
    frequency_hz: float, gain: float, free: float = 0.0, found: float = SETTINGS.found
) -> SwayFit | None:
    """What the regressions make of a camera and a distance sensor; the stop is known at once."""
    rng, seconds = np.random.default_rng(5), 2.0
    fine = np.arange(-4.0, seconds, 0.002)
    sway = swayed(frequency_hz, gain, free, fine)
    ramp = np.clip(fine, 0.0, 1.0)
    speed = 0.104 * (1.0 - ramp)
    unit = np.cumsum(speed) * 0.002
    bank = sway_bank.empty(SETTINGS)
    for k in range(round((4.0 + seconds) / T0)):
        t = -4.0 + k * T0
        a = BRAKE if 0.0 <= t < 1.0 else 0.0
        bank = sway_bank.predict(SETTINGS, bank, T0, a, stands=t > 1.05)
        now = float(np.interp(t, fine, unit)) + rng.normal(0.0, UNIT_SIGMA)
        distance = PositionMeasurement(Source.DISTANCE, now, 0.0, UNIT_SIGMA**2, 4.0)
        bank = sway_bank.read_unit(bank, distance, 0.104)
        seen = float(np.interp(t - DELAY, fine, unit + sway)) + rng.normal(0.0, SIGMA)
        image = PositionMeasurement(Source.CAMERA, seen, DELAY, SIGMA**2, 5.0)
        bank = sway_bank.read(SETTINGS, bank, image, a, max(t, 0.0))
    return sway_bank.evaluate(replace(SETTINGS, found=found), bank)[1]


@pytest.mark.parametrize("frequency_hz", [0.5, 0.62, 0.83, 1.0, 1.2, 2.0])
def test_a_stop_tells_frequency_and_gain_of_a_pendulum(frequency_hz: float) -> None:
    fit = followed(frequency_hz, gain=1.0)
    assert fit is not None
    assert fit.score > SETTINGS.found
    assert fit.omega == pytest.approx(math.tau * frequency_hz, rel=0.06)
    assert fit.values[2] == pytest.approx(1.0, abs=0.35)
    now = swayed(frequency_hz, 1.0, 0.0, np.arange(-4.0, 2.0, 0.002))[-1]
    assert fit.values[0] == pytest.approx(now, abs=0.2 * abs(BRAKE) / fit.omega**2 + 5e-4)


def test_a_free_swing_is_found_and_has_no_gain() -> None:
    fit = followed(1.2, gain=0.0, free=0.0036)
    assert fit is not None
    assert fit.score > SETTINGS.found
    assert fit.omega == pytest.approx(math.tau * 1.2, rel=0.03)
    assert abs(fit.values[2]) < 0.35


def test_a_body_that_does_not_sway_has_none() -> None:
    assert followed(1.0, gain=0.0, found=0.0) is None


def test_an_acceleration_that_is_noticed_late_is_made_up_for() -> None:
    early = late = sway_bank.empty(SETTINGS)
    for _ in range(20):
        early = sway_bank.predict(SETTINGS, early, T0, BRAKE, stands=False)
        late = sway_bank.predict(SETTINGS, late, T0, 0.0, stands=False)
    late = sway_bank.change_class(SETTINGS, late, BRAKE, 20 * T0)
    np.testing.assert_allclose(late.forced, early.forced, rtol=1e-9, atol=1e-15)


def test_the_response_is_that_of_the_differential_equation() -> None:
    w = math.tau * 0.62
    pole = w * complex(-SETTINGS.damping, 1.0)
    times = np.arange(0.0, 0.9, 0.1)
    expected = swayed(0.62, 1.0, 0.0, np.concatenate(((-4.0,), times)))[1:]
    own = BRAKE * sway_bank.response(w, pole, times).real
    np.testing.assert_allclose(own, expected, atol=2e-5)
    assert sway_bank.response(w, pole, 0.01) == pytest.approx(
        1j / w * (cmath.exp(pole * 0.01) - 1.0) / pole
    )


def test_another_sensor_of_the_body_may_have_another_offset() -> None:
    bank = sway_bank.empty(SETTINGS)
    unit = PositionMeasurement(Source.DISTANCE, 0.0, 0.0, UNIT_SIGMA**2, 4.0)
    for k in range(400):
        bank = sway_bank.predict(SETTINGS, bank, T0, 0.0, stands=True)
        bank = sway_bank.read_unit(bank, unit, 0.0)
        source, value = (Source.CAMERA, 0.0) if k < 200 else (Source.TACTILE, 0.001)
        reading = PositionMeasurement(source, value, 0.0, 1e-8, 5.0)
        bank = sway_bank.read(SETTINGS, bank, reading, 0.0, 10.0)
    assert sway_bank.evaluate(SETTINGS, bank)[1] is None


def test_a_gain_that_is_not_identified_is_less_certain_where_the_tool_touches() -> None:
    bank = sway_bank.empty(SETTINGS)
    seen, felt = (structs.replace(bank, source=each) for each in (Source.CAMERA, Source.TACTILE))
    assert sway_bank.gain_deviation(felt) > 2.0 * sway_bank.gain_deviation(seen)


@pytest.mark.parametrize("ringing_hz", [1.2, 4.7])
def test_a_body_that_the_tool_pushes_keeps_its_frequency_unless_it_rings_at_another(
    ringing_hz: float,
) -> None:
    """The images end 2 s before the touch, and kicks of 30 N for 0.1 s move the body after it."""
    settings = replace(SETTINGS, frequency_hz=1.2, gain=0.9, gain_deviation=0.08)
    bank, rng = sway_bank.empty(settings), np.random.default_rng(3)
    unit = PositionMeasurement(Source.DISTANCE, 0.0, 0.0, UNIT_SIGMA**2, 4.0)
    sway, others = 0.001 + 0.0j, []
    for k in range(round(5.0 / T0)):
        t = k * T0
        hz = ringing_hz if t > 3.5 else 1.2
        sway *= cmath.exp(complex(-0.02, 1.0) * math.tau * hz * T0)
        if t > 3.5 and k % 8 == 0:
            sway += 1j * rng.normal(0.0, 0.003 / (math.tau * hz))
        bank = sway_bank.predict(settings, bank, T0, 0.0, stands=True)
        bank = sway_bank.read_unit(bank, unit, 0.0)
        source, sigma = (Source.CAMERA, 0.0005) if t < 1.5 else (Source.TACTILE, 5e-5)
        if 1.5 < t < 3.5:
            continue
        seen = PositionMeasurement(source, sway.real + rng.normal(0.0, sigma), 0.0, sigma**2, 5.0)
        bank = sway_bank.read(settings, bank, seen, 0.0, 10.0)
        if t > 3.7 and sway_bank.is_due(bank):
            bank, other = sway_bank.evaluate(settings, bank, math.tau * 1.2, 10.0)
            others += [other] if other is not None else []
    found = [fit.omega / math.tau for fit in others]
    assert not found if ringing_hz == 1.2 else found[-1] == pytest.approx(ringing_hz, rel=0.1)


@pytest.mark.parametrize("is_accepted", [True, False])
def test_a_unit_that_is_lost_begins_again(is_accepted: bool) -> None:
    """A wrong stop has moved the unit; readings that the filter takes then show where it is."""
    bank = sway_bank.empty(SETTINGS)
    reading = PositionMeasurement(Source.DISTANCE, 0.0, 0.0, UNIT_SIGMA**2, 4.0)
    bank = sway_bank.read_unit(bank, reading, 0.0)
    assert bank.unit is not None
    lost = structs.replace(bank.unit, position=-0.2)
    bank = sway_bank.count_push(structs.replace(bank, unit=lost, age=9.0, base=0.2))
    for _ in range(sway_bank.MOST_REJECTED):
        assert bank.unit.position == pytest.approx(-0.2)
        bank = sway_bank.predict(SETTINGS, bank, T0, 0.0, stands=True)
        bank = sway_bank.read_unit(bank, reading, 0.0, is_accepted=is_accepted)
        bank = sway_bank.with_unit_found(SETTINGS, bank, reading, 0.0)
    assert bank.unit.position == pytest.approx(0.0 if is_accepted else -0.2)
    # What the body did against a lost unit is forgotten, and no sway is taken of it.
    assert (bank.base is None) is is_accepted
    assert (bank.age == 0.0) is is_accepted
    assert bank.pushes > 0.9


@pytest.mark.parametrize("damping", [0.0, 0.05, 1.3])
def test_a_response_at_one_time_is_that_of_many_bit_for_bit(damping: float) -> None:
    times = np.linspace(0.0, 0.6, 301)
    for omega in (0.7, 6.2, 19.0):
        pole = omega * complex(-damping, 1.0)
        single = [sway_bank.response_at(omega, pole, time) for time in times.tolist()]
        assert single == [complex(sway_bank.response(omega, pole, time)) for time in times.tolist()]
