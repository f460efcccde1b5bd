"""Inverse filters of servos (12) and elastic modes (11), designed off line.

A model is its frequency response at the sampling instants. The inverse is the least squares fit
``R(w) H(w) = 1`` over the band of the desired motion.

Invariants:
- Taps sum to 1: no error at rest.
- The reach is short: a tap that reads behind the commit point reads a plan that may still change.
"""

import math

import numpy as np

from linemate.daemon.core.control.settings import EffectorMode, FilterSettings, ServoModel
from linemate.daemon.core.horizon import Array

SPREAD_S = 0.004  # length of one of the three means over the last commands [s]
LEAST_PAST, LEAST_FUTURE = 3, 1  # steps of a filter, however long the cycle


def ramp_response(t: Array, omega: float, damping: float) -> Array:
    """Return the response of ``w^2 / (s^2 + 2 z w s + w^2)`` to a unit ramp from t = 0."""
    z, w = damping, omega
    late = np.maximum(t, 0.0)
    if abs(z - 1.0) < 1e-6:
        answer = late - 2.0 / w + np.exp(-w * late) * (2.0 / w + late)
    elif z < 1.0:
        d = w * math.sqrt(1.0 - z * z)
        swing = (2.0 * z / w) * np.cos(d * late) + ((2.0 * z * z - 1.0) / d) * np.sin(d * late)
        answer = late - 2.0 * z / w + np.exp(-z * w * late) * swing
    else:
        root = math.sqrt(z * z - 1.0)
        p, m = w * (-z + root), w * (-z - root)  # poles
        a = w * w / (p * p * (p - m))
        b = w * w / (m * m * (m - p))
        answer = late - 2.0 * z / w + a * np.exp(p * late) + b * np.exp(m * late)
    return np.where(t > 0.0, answer, 0.0)


def servo_pulse(model: ServoModel, cycle_s: float) -> Array:
    """Return the pulse response h (m,) of one axis at the sampling instants.

    ``q(k) = sum_j h_j q_c(k - j)``: the controller interpolates from one setpoint to the next
    over the cycle *after* its telegram; dead time and servo follow. A setpoint is a triangle of
    ramps, whose responses are known in closed form.
    """
    omega, z = 2.0 * math.pi * model.frequency_hz, model.damping
    slowest = omega * (z - math.sqrt(max(z * z - 1.0, 0.0)))  # of the poles' decays
    length = math.ceil((model.dead_time + 12.0 / slowest) / cycle_s) + 3
    t = np.arange(length) * cycle_s - model.dead_time

    def ramp(shift: int) -> Array:
        return ramp_response(t - shift * cycle_s, omega, model.damping)

    h: Array = (ramp(0) - 2.0 * ramp(1) + ramp(2)) / cycle_s
    normed: Array = h / h.sum()
    return normed


def _response(pulse: Array, omega: Array, cycle_s: float) -> Array:
    """Return the frequency response of a pulse response at ``omega`` [rad/s], complex."""
    j = np.arange(len(pulse))
    answer: Array = np.exp(-1j * np.outer(omega * cycle_s, j)) @ pulse
    return answer


def _fit(
    response: Array,
    omega: Array,
    weight: Array,
    taps: Array,
    delay: float,
    cycle_s: float,
    ridge: float,
) -> Array:
    """Return the taps (m,) that minimise ``weight |R H - 1|^2 + ridge |R|^2``.

    Two constraints: the taps sum to 1 (exact at rest) and lead by the model's delay [steps] (exact
    on a ramp; without it a 4 Hz servo keeps 36 um at 106 mm/s).
    """
    shift = np.exp(1j * np.outer(omega * cycle_s, taps)) * response[:, None]
    A = np.vstack((shift.real, shift.imag)) * np.tile(weight, 2)[:, None]
    b = np.concatenate((np.ones(len(omega)), np.zeros(len(omega)))) * np.tile(weight, 2)
    m = len(taps)
    scale = ridge * len(omega)
    normal = np.zeros((m + 2, m + 2))
    normal[:m, :m] = A.T @ A + scale * np.eye(m)
    normal[:m, m] = normal[m, :m] = 1.0
    normal[:m, m + 1] = normal[m + 1, :m] = taps
    right = np.concatenate((A.T @ b, (1.0, delay)))
    fitted: Array = np.linalg.solve(normal, right)[:m]
    return fitted


def _band(settings: FilterSettings) -> tuple[Array, Array]:
    """Return the training band: ``omega`` (m,) [rad/s] and the signal's amplitude in it.

    The motions are slow (a conveyor at constant speed, a swing below 1 Hz). The weight of the
    lowest frequencies makes ramps exact, the tenth part above covers the merge.
    """
    f = np.linspace(0.02, settings.wide_hz, 400)
    weight = np.where(f <= settings.band_hz, 1.0, 0.1) + 2.0 * np.exp(-((f / 0.5) ** 2))
    return 2.0 * math.pi * f, weight


def tap_steps(past_s: float, future_s: float, cycle_s: float) -> Array:
    """Return the steps (m,) that an inverse filter reads, from past to future.

    However long the cycle is, three are of the past and one is of the future: an elastic mode
    needs them. With one step of 24 ms and none of the future nothing was damped.
    """
    past = max(math.ceil(past_s / cycle_s - 1e-6), LEAST_PAST) if past_s > 0.0 else 0
    future = max(math.ceil(future_s / cycle_s - 1e-6), LEAST_FUTURE) if future_s > 0.0 else 0
    return np.arange(-past, future + 1, dtype=np.float64)


def spreading(cycle_s: float) -> Array:
    """Return the weights (m,) of the last commands, newest first, that are sent as their mean.

    (12) reads a plan that may still change. A change of d in one cycle asks for an acceleration of
    d / T0^2 and a jerk of d / T0^3. Below 4 ms it is spread over three times 4 ms: both stay as
    they are at 4 ms. From 4 ms on the command is sent as it is.
    """
    steps = max(round(SPREAD_S / cycle_s), 1)
    box = np.full(steps, 1.0 / steps)
    weights: Array = np.convolve(np.convolve(box, box), box)
    return weights


def servo_inverse(model: ServoModel, settings: FilterSettings, cycle_s: float) -> Array:
    """Return the taps of (12) for one axis, over ``tap_steps`` of the servo's reach.

    They invert the servo and the spreading of the commands.
    """
    omega, weight = _band(settings)
    pulse = servo_pulse(model, cycle_s)
    weights = spreading(cycle_s)
    if len(weights) > 1:
        pulse = np.convolve(pulse, weights)
    response = _response(pulse, omega, cycle_s)
    delay = float(np.arange(len(pulse)) @ pulse)
    taps = tap_steps(settings.servo_past_s, settings.servo_future_s, cycle_s)
    return _fit(response, omega, weight, taps, delay, cycle_s, settings.ridge)


def effector_inverse(mode: EffectorMode, settings: FilterSettings, cycle_s: float) -> Array:
    """Return the taps of (11) for one elastic mode.

    The tcp follows its undeflected position through ``(2 z w s + w^2) / (s^2 + 2 z w s + w^2)``:
    the suspension is moved at its base.
    """
    omega, weight = _band(settings)
    w = 2.0 * math.pi * mode.frequency_hz
    s = 1j * omega
    response = (2.0 * mode.damping * w * s + w * w) / (s * s + 2.0 * mode.damping * w * s + w * w)
    taps = tap_steps(settings.effector_past_s, settings.effector_future_s, cycle_s)
    return _fit(response, omega, weight, taps, 0.0, cycle_s, settings.ridge)
