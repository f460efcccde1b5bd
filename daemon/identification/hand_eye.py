"""Camera pose in the tool, stamp error, latency and period, from a fitted scene.

Invariants:
- A value that only the prior determines is refused as not observable. A hand-eye position needs a
  rotating tool, a stamp error a relative motion of tool and object.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import chi2

from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.daemon.identification.scene_fit import SHARED, SceneFit, Views
from linemate.daemon.identification.trace import Images

POSITION_DEVIATION = 0.0015  # [m]
ANGLE_DEVIATION = 0.004  # [rad]
STAMP_DEVIATION = 0.003  # [s]
CHANCE = 1e-3  # probability that a pose which is right is corrected
LOSSES = 5.0  # most images in a row that count as lost


@dataclass(frozen=True, slots=True)
class CameraResult:
    """Outcomes about the camera.

    Attributes:
        position: three corrections of the hand-eye position, in the tcp [m].
        rotation: three corrections of its rotation, about the camera's axes [rad].
        stamp_error: correction of the exposure stamps [s].
        latency: from exposure to arrival by the stamps [s]; its deviation is the spread.
    """

    position: tuple[Outcome, ...]
    rotation: tuple[Outcome, ...]
    stamp_error: Outcome
    latency: Outcome
    period: Outcome


def identify_camera(
    scene: SceneFit | None, seen: Sequence[Views], images: Sequence[Images]
) -> CameraResult:
    """Return the camera's outcomes from a fitted scene."""
    latency, period = _times(images)
    if scene is None:
        refusal = Refusal("too few images of the object in free space")
        three = (refusal, refusal, refusal)
        return CameraResult(three, three, refusal, latency, period)
    deviations = np.sqrt(np.maximum(scene.covariance[-SHARED:, -SHARED:].diagonal(), 0.0))
    turned = max(_turned(view) for view in seen)
    basis = f"{sum(len(view.times) for view in seen)} images, tool turned by {turned:.2f} rad"
    position = tuple(
        _outcome(
            float(scene.hand_eye[i]),
            float(deviations[i]),
            POSITION_DEVIATION,
            basis,
            f"not observable: the tool turned by only {turned:.2f} rad in the images "
            f"(known to +-{1e3 * deviations[i]:.1f} mm)",
        )
        for i in range(3)
    )
    rotation = tuple(
        _outcome(
            float(scene.hand_eye[3 + i]),
            float(deviations[3 + i]),
            ANGLE_DEVIATION,
            basis,
            "not observable: the tool did not move enough in the images "
            f"(known to +-{1e3 * deviations[3 + i]:.1f} mrad)",
        )
        for i in range(3)
    )
    stamp = _outcome(
        scene.stamp_error,
        float(deviations[6]),
        STAMP_DEVIATION,
        f"{basis}, relative speed up to {max(_relative_speed(view) for view in seen):.2f} m/s",
        "not observable: tool and object hardly move against each other "
        f"(known to +-{1e3 * deviations[6]:.1f} ms)",
    )
    return CameraResult(position, rotation, stamp, latency, period)


def corrections(outcomes: Sequence[Outcome]) -> Array:
    """Return what a configured pose is corrected by, zeros unless it is significantly off.

    The outcomes are judged together: a camera may be off a little along each axis. A correction
    within its deviation would add more than it takes away, so that value stays as configured.
    """
    rows = [(e.value, e.deviation) if isinstance(e, Estimate) else (0.0, 1.0) for e in outcomes]
    values, deviations = np.array(rows).T
    known = sum(isinstance(outcome, Estimate) for outcome in outcomes)
    if not known or chi2.sf(float(np.sum((values / deviations) ** 2)), known) > CHANCE:
        return np.zeros(len(outcomes))
    return np.where(np.abs(values) > deviations, values, 0.0)


def _outcome(value: float, deviation: float, limit: float, basis: str, reason: str) -> Outcome:
    return Estimate(value, deviation, basis) if deviation <= limit else Refusal(reason)


def _turned(view: Views) -> float:
    """Return the largest rotation of the tool over the images [rad]."""
    poses = view.tcp_path.spline(view.times)
    return float(np.ptp(poses[:, 3:], axis=0).max())


def _relative_speed(view: Views) -> float:
    rates: Array = view.tcp_path.rates(view.times)[:, :3].copy()
    rates[:, 1] -= view.speed
    return float(np.percentile(np.linalg.norm(rates, axis=1), 95))


def _times(images: Sequence[Images]) -> tuple[Outcome, Outcome]:
    """Return latency and period as stamped."""
    delays = np.concatenate([i.arrivals - i.exposures for i in images] or [np.zeros(0)])
    gaps = np.concatenate([np.diff(np.sort(i.exposures)) for i in images] or [np.zeros(0)])
    if len(delays) < 10 or len(gaps) < 10:
        refusal = Refusal("fewer than ten images")
        return refusal, refusal
    basis = f"{len(delays)} images, longest {1e3 * float(delays.max()):.0f} ms"
    latency = Estimate(float(np.mean(delays)), float(np.std(delays)), basis)
    usual = float(np.median(gaps))
    spread = float(1.4826 * np.median(np.abs(gaps - usual)))
    # A longer gap is an occlusion, not a loss.
    steps = np.round(gaps / usual)
    lost = float(np.sum(steps[(steps > 1.0) & (steps <= LOSSES)] - 1.0))
    return latency, Estimate(
        usual, spread, f"{len(gaps)} images, {100.0 * lost / (lost + len(gaps)):.1f} % missing"
    )
