"""Sway of the body along the line, from stops and starts that the camera sees.

    s'' + 2 zeta w s' + w^2 s = -g a

s: the body against the conveyor's unit [m], without its swings; a: the unit's
acceleration, of ramps that are fitted to the distance sensor's readings (a body would seem to
answer to their noise). With their way x

    s = -g (x - y),    y'' + 2 zeta w y' + w^2 y = 2 zeta w x' + w^2 x.

For each frequency and damping the rest is linear: gain, offset, drift and a free sway of each
window, an error of the distance sensor's scale, and one of the delays between the sensors.

Invariants:
- Deviations count what is left at the sway's own frequency, where a camera's noise is no white one.
- A sway without a gain beyond chance is none; its gain is then bounded.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.signal import lfilter

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.settings import SwaySettings
from linemate.daemon.identification.conveyor_ramps import STEP_S, UnitMotion, find_ramps, motion
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal, ReportLine
from linemate.daemon.identification.scene_fit import Camera, SceneFit, Views, swing
from linemate.daemon.identification.trace import Trace

ALONG = 1  # axis of c
SEARCH_HZ = (0.4, 4.0)
LOWEST_HZ = SwaySettings().range_hz[0]  # of the slowest sway of which a daemon takes account
GRID = 0.03  # of the frequencies that are tried, as a share
DAMPINGS = (0.005, 0.02, 0.06)  # that are tried
MOST_DAMPING = 0.3
# Images around a ramp that are used. A free sway of 1 Hz and 1 % damping lasts 16 s, at the body's
# own frequency; before a stop a chain drives it at another one.
BEFORE_S, AFTER_S = 1.5, 12.0
SEEN_S = 6.0  # after a ramp, in which images have to show the body: what it excites fades
LEAST_IMAGES = 40
SHARED = 3  # terms of all windows: gain, scale and delay
OWN = 4  # terms of each window: offset, drift, free sway
SCALE, DELAY = 0.01, 0.02  # prior deviations of scale and delay [s]
GATE = 5.0  # of an image, in deviations
CHANCE = 30.0  # least gain in chi2 of a sway: over all frequencies less than 1e-4 by chance
FREQUENCY_SHARE = 0.05  # largest deviation of an accepted frequency, as a share
GAIN_DEVIATION = 0.25  # largest deviation of an accepted gain
DAMPING_DEVIATION = 0.02  # largest deviation of an accepted damping
MODEL = 0.005, 0.002, 0.04  # frequency (share), damping, gain: what a fitted ramp leaves
LEAST = 0.0001  # smallest deviation of a gain that a setting may have
CARS = 0.02, 0.05  # least spread of frequency and gain: cars differ
NEAR = (0.6, 1.6)  # frequencies around the sway whose noise counts, as shares


@dataclass(frozen=True, slots=True)
class SwayResult:
    """Sway along the line.

    Attributes:
        settings: what goes into an overlay; empty if it is refused.
    """

    settings: dict[str, float]
    frequency_hz: Outcome
    gain: Outcome
    damping: Outcome


@dataclass(frozen=True, slots=True, eq=False)
class _Window:
    """Images around a ramp: times (m,), body against the unit (m,), sigma (m,), all [s, m]."""

    times: Array
    seen: Array
    sigma: Array
    moved: UnitMotion


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """Fit at one frequency: residuals (n,), terms, and their covariance for white noise."""

    left: Array
    terms: Array
    covariance: Array


def identify_sway(
    scene: SceneFit | None,
    seen: Sequence[Views],
    bodies: Sequence[int],
    traces: Sequence[Trace],
    camera: Camera,
    delay: float,
    lowest_hz: float = LOWEST_HZ,
) -> SwayResult:
    """Return the sway along the line.

    Args:
        scene: fitted to the images.
        seen: images of stretches of free space.
        bodies: index of the recording of each.
        delay: from measuring to arrival of a distance [s].
        lowest_hz: frequency of the slowest sway of ``tracking.sway``.
    """
    fitted = _fitted_sway(scene, seen, bodies, traces, camera, delay)
    return _refused(fitted) if isinstance(fitted, str) else _judged(*fitted, lowest_hz)


def _fitted_sway(
    scene: SceneFit | None,
    seen: Sequence[Views],
    bodies: Sequence[int],
    traces: Sequence[Trace],
    camera: Camera,
    delay: float,
) -> tuple[list[_Window], float, float] | str:
    """Return images around ramps, frequency [rad/s] and damping; or why there are none."""
    if scene is None:
        return "too few images of the object in free space"
    motions = {i: motion(traces[i], delay) for i in set(bodies)}
    windows = [
        window
        for index, (view, body) in enumerate(zip(seen, bodies, strict=True))
        if (moved := motions[body]) is not None
        for window in _windows(scene, index, view, moved, camera)
    ]
    if not windows:
        return "no stop and no start while the camera sees the object"
    windows = _cleaned(windows)
    omega, zeta = _searched(windows)
    windows = _timed(windows, omega, zeta)
    windows = [
        window if kept.all() else _part(window, kept)
        for window, kept in _inliers(windows, omega, zeta)
    ]
    return windows, *_refined(windows, omega, zeta)


def findings(result: SwayResult) -> list[ReportLine]:
    """Return the lines of the report."""
    is_found = isinstance(result.frequency_hz, Estimate)
    lines = [ReportLine("sway frequency", "Hz", 1.0, result.frequency_hz, is_found)]
    if is_found or isinstance(result.gain, Estimate):
        lines += [ReportLine("sway gain", "", 1.0, result.gain, bool(result.settings))]
    if isinstance(result.frequency_hz, Estimate):
        in_overlay = "damping" in result.settings
        lines += [ReportLine("sway damping", "", 1.0, result.damping, in_overlay)]
    return lines


def _refused(reason: str) -> SwayResult:
    refusal = Refusal(reason)
    return SwayResult({}, refusal, refusal, refusal)


def _windows(
    scene: SceneFit, index: int, view: Views, moved: UnitMotion, camera: Camera
) -> list[_Window]:
    """Return the images around each ramp; ramps that follow each other share a window."""
    t = view.times + scene.stamp_error
    p, R = view.tcp_path.at(t)
    eye = camera[0] + scene.hand_eye[:3]
    turned = camera[1] @ rotations.exp(scene.hand_eye[3:])
    in_tcp = eye + view.positions @ turned.T
    body = p[:, ALONG] + np.einsum("nj,nj->n", R[:, ALONG], in_tcp)
    for mode, amplitude in zip(scene.modes, scene.rests[index].amplitudes, strict=True):
        body -= mode.levers[ALONG] * swing(mode, amplitude, t - view.middle)
    t = t + scene.late
    body -= np.interp(t, moved.times, moved.positions)
    in_camera = np.einsum("nj,jk->nk", R[:, ALONG], turned)
    sigma = np.sqrt(np.sum((in_camera * view.deviations[:, :3]) ** 2, axis=1))
    spans: list[tuple[float, float]] = []
    for ramp in find_ramps(moved):
        begin, end = ramp.begin - BEFORE_S, ramp.end + AFTER_S
        if spans and begin < spans[-1][1]:
            spans[-1] = (spans[-1][0], end)
        else:
            spans.append((begin, end))
    windows = []
    for begin, end in spans:
        inside = (t > max(begin, moved.times[0])) & (t < min(end, moved.times[-1]))
        if np.sum(inside & (t < end - AFTER_S + SEEN_S)) >= LEAST_IMAGES:
            windows.append(_Window(t[inside], body[inside], sigma[inside], moved))
    return windows


def _part(window: _Window, kept: Any) -> _Window:
    return replace(
        window, times=window.times[kept], seen=window.seen[kept], sigma=window.sigma[kept]
    )


def _cleaned(windows: Sequence[_Window]) -> list[_Window]:
    """Return the windows without images far from the median."""
    cleaned = []
    for window in windows:
        off = np.abs(window.seen - np.median(window.seen))
        far = GATE * 1.4826 * max(float(np.median(off)), 1e-3)
        cleaned.append(_part(window, off < far))
    return cleaned


def _timed(windows: Sequence[_Window], omega: float, zeta: float) -> list[_Window]:
    """Return the windows with the delay between the sensors taken out."""
    delay = float(_fitted(windows, omega, zeta).terms[2])
    timed = []
    for window in windows:
        moved, t = window.moved, window.times + delay
        before, after = (np.interp(at, moved.times, moved.positions) for at in (window.times, t))
        timed.append(replace(window, times=t, seen=window.seen - (after - before)))
    return timed


def _inliers(windows: Sequence[_Window], omega: float, zeta: float) -> list[tuple[_Window, Any]]:
    left = _fitted(windows, omega, zeta).left
    limit = GATE * 1.4826 * float(np.median(np.abs(left)))
    ends = np.cumsum([len(window.times) for window in windows])[:-1]
    parts = np.split(np.abs(left[: sum(len(w.times) for w in windows)]) < limit, ends)
    return list(zip(windows, parts, strict=True))


def _response(moved: UnitMotion, omega: float, zeta: float) -> Array:
    """Return the unit's motion that the body does not follow, x - y (n,) [m], from steady speed."""
    k, fall, square = 2.0 / STEP_S, 2.0 * zeta * omega, omega * omega  # Tustin's rule
    over = (fall * k + square, 2.0 * square, square - fall * k)
    under = (k * k + fall * k + square, 2.0 * (square - k * k), k * k - fall * k + square)
    y = lfilter(np.array(over) / under[0], np.array(under) / under[0], moved.ways)
    response: Array = moved.ways - y
    return response


def _terms(windows: Sequence[_Window], omega: float, zeta: float) -> Array:
    """Return the weighed terms (n, all), priors of scale and delay at the end."""
    size = SHARED + OWN * len(windows)
    blocks = []
    for i, window in enumerate(windows):
        moved, t = window.moved, window.times
        x = np.interp(t, moved.times, moved.positions)
        u = t - t[0]
        fall = np.exp(-zeta * omega * u)
        rows = np.zeros((len(t), size))
        rows[:, 0] = -np.interp(t, moved.times, _response(moved, omega, zeta))
        rows[:, 1], rows[:, 2] = x - x[0], np.interp(t, moved.times, moved.speeds)
        own = slice(SHARED + OWN * i, SHARED + OWN * (i + 1))
        rows[:, own] = np.column_stack(
            (np.ones_like(u), u, fall * np.cos(omega * u), fall * np.sin(omega * u))
        )
        blocks.append(rows / window.sigma[:, None])
    prior = np.zeros((2, size))
    prior[0, 1], prior[1, 2] = 1.0 / SCALE, 1.0 / DELAY
    return np.concatenate((*blocks, prior))


def _wanted(windows: Sequence[_Window]) -> Array:
    return np.concatenate((*(window.seen / window.sigma for window in windows), np.zeros(2)))


def _fitted(windows: Sequence[_Window], omega: float, zeta: float, *, forced: bool = True) -> _Fit:
    X, y = _terms(windows, omega, zeta), _wanted(windows)
    if not forced:
        X[:, 0] = 0.0
    scale = np.maximum(np.sqrt(np.sum(X * X, axis=0)), 1e-12)
    terms = np.linalg.lstsq(X / scale, y, rcond=1e-10)[0] / scale
    covariance = np.linalg.pinv((X / scale).T @ (X / scale), hermitian=True)
    return _Fit(y - X @ terms, terms, covariance / np.outer(scale, scale))


def _searched(windows: Sequence[_Window]) -> tuple[float, float]:
    """Return the frequency [rad/s] and damping that a grid says."""
    count = 1 + math.ceil(math.log(SEARCH_HZ[1] / SEARCH_HZ[0]) / GRID)
    tried = [
        (2.0 * math.pi * f, zeta)
        for f in np.geomspace(*SEARCH_HZ, count).tolist()
        for zeta in DAMPINGS
    ]
    return min(tried, key=lambda each: float(np.abs(_fitted(windows, *each).left).sum()))


def _refined(windows: Sequence[_Window], omega: float, zeta: float) -> tuple[float, float]:
    def left(p: Array) -> Array:
        return _fitted(windows, math.exp(p[0]), float(p[1])).left

    low, high = (math.log(2.0 * math.pi * f) for f in SEARCH_HZ)
    fit = least_squares(
        left,
        (math.log(omega), zeta),
        bounds=((low - GRID, 0.0), (high + GRID, MOST_DAMPING)),
        x_scale=(0.01, 0.01),
        diff_step=np.full(2, 1e-4),
    )
    return math.exp(fit.x[0]), float(fit.x[1])


def _noise(windows: Sequence[_Window], left: Array, omega: float) -> float:
    """Return the variance of what is left around a frequency, 1 for honest white noise."""
    frequencies = omega * np.linspace(*NEAR, 24)
    power, count = np.zeros(len(frequencies)), 0
    for window in windows:
        e = left[count : count + len(window.times)]
        count += len(e)
        power += np.abs(np.exp(-1j * np.outer(frequencies, window.times)) @ e) ** 2
    white = float(left[:count] @ left[:count]) / max(count - SHARED - OWN * len(windows), 1)
    return max(float(power.mean()) / count, white)


def _deviations(
    windows: Sequence[_Window], fit: _Fit, omega: float, zeta: float, noise: float
) -> tuple[float, float, float]:
    """Return the deviations of frequency (as a share), damping and gain."""
    step = np.array((1e-4, 1e-4))
    here = _terms(windows, omega, zeta)
    slopes = np.column_stack(
        (
            (_terms(windows, omega * math.exp(step[0]), zeta) - here) @ fit.terms / step[0],
            (_terms(windows, omega, zeta + step[1]) - here) @ fit.terms / step[1],
        )
    )
    X = np.column_stack((slopes, here))
    scale = np.maximum(np.sqrt(np.sum(X * X, axis=0)), 1e-12)
    inverse = np.linalg.pinv((X / scale).T @ (X / scale), hermitian=True)
    deviations = np.sqrt(np.maximum(inverse.diagonal() * noise, 0.0)) / scale
    share, damping, gain = np.hypot(deviations[:3], MODEL).tolist()
    return share, damping, gain


def _judged(windows: Sequence[_Window], omega: float, zeta: float, lowest_hz: float) -> SwayResult:
    fit = _fitted(windows, omega, zeta)
    noise = _noise(windows, fit.left, omega)
    none = _fitted(windows, omega, zeta, forced=False)
    better = float(none.left @ none.left - fit.left @ fit.left) / noise
    if better < CHANCE:
        return _none(windows, lowest_hz)
    share, damping, deviation = _deviations(windows, fit, omega, zeta, noise)
    frequency, gain = omega / (2.0 * math.pi), float(fit.terms[0])
    images = sum(len(window.times) for window in windows)
    basis = f"{images} images around {len(windows)} stops and starts"
    if share > FREQUENCY_SHARE:
        return _refused(f"its frequency is known only to +-{share * frequency:.2g} Hz")
    if deviation > GAIN_DEVIATION:
        return _refused(f"its gain is known only to +-{deviation:.2g}")
    if not SEARCH_HZ[0] < frequency < SEARCH_HZ[1]:
        return _refused(f"not between {SEARCH_HZ[0]:g} and {SEARCH_HZ[1]:g} Hz")
    if not 0.0 < gain <= 2.0:
        return _refused(f"a gain of {gain:.2f} is none of a body: compare the sensors' stamps")
    settings = {
        "frequency_hz": frequency,
        "spread": max(share, CARS[0]),
        "gain": gain,
        "gain_deviation": max(deviation, CARS[1]),
    }
    damped: Outcome = Refusal(f"known only to +-{damping:.2g}")
    if damping < DAMPING_DEVIATION:
        damped = Estimate(zeta, damping, basis)
        settings["damping"] = zeta
    return SwayResult(
        settings,
        Estimate(frequency, share * frequency, basis),
        Estimate(gain, deviation, basis),
        damped,
    )


def _none(windows: Sequence[_Window], lowest_hz: float) -> SwayResult:
    """Return the result that stops show no sway, with the largest gain that may hide.

    It is the gain of the slowest sway that displaces the body as far as any that may hide: for each
    m/s^2 of a ramp that is ``g / w^2``. A gain above 1 is none of a body.
    """
    hidden = 0.0
    for f in np.geomspace(lowest_hz, SEARCH_HZ[1], 24).tolist():
        fit = _fitted(windows, 2.0 * math.pi * f, DAMPINGS[1])
        noise = _noise(windows, fit.left, 2.0 * math.pi * f)
        gain = math.hypot(float(fit.terms[0]), math.sqrt(float(fit.covariance[0, 0]) * noise))
        hidden = max(hidden, min(gain, 1.0) * (lowest_hz / f) ** 2)
    if hidden > GAIN_DEVIATION:
        return _refused("neither a sway nor its absence: the stops are too gentle for the camera")
    stops = f"{len(windows)} stops and starts"
    none = Refusal(f"none from {lowest_hz:.2g} to {SEARCH_HZ[1]:.2g} Hz in {stops}")
    unseen = Estimate(0.0, hidden, f"{stops}: at {lowest_hz:.2g} Hz, or as far if faster")
    settings = {"frequency_hz": 0.0, "gain": 0.0, "gain_deviation": max(hidden, LEAST)}
    return SwayResult(settings, none, unseen, none)
