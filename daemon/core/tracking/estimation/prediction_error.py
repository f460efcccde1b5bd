"""Measured error of past predictions: where the object was predicted, and where it was seen then.

The error needs no model of the object: a swing that is not modelled, a wrong delay, a bending arm
and a conveyor that runs askew all show in it.

Invariants:
- A prediction is compared with measurements as they came, not with an estimate made from them.
- A prediction made before a change of the conveyor's class is no evidence after it.
- Nor is one that was uncertain by the estimate's own covariance: it may be young, not wrong.
- Memory is bounded.
"""

import math
from bisect import bisect_left, bisect_right
from collections.abc import Sequence
from functools import lru_cache

from msgspec import Struct

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.daemon.core.tracking.observation import PoseMeasurement

SHORT_LEAD_S = 0.25  # delay of robot and camera together [s]
LONGEST_LEAD_S = 1.5  # bound of the time from the last waypoint before contact to the contact [s]
LEADS = 2  # short and long
SPACING_S = 0.036  # time between two predictions that are kept [s]
LARGEST_GAP_NS = 120_000_000  # between two of them that an image may lie between
FORGOTTEN_NS = 3_000_000_000  # without a compared image, after which the errors before are too old
MOST_ERRORS = 256  # that are kept
WINDOW_S = 1.0  # errors of this time count [s]
QUANTILE = 0.9  # of their sizes: a single outlier does not count
NOISE_SHARE = 1.03  # of an image's variance across in that quantile of medians of three
LEAST_SHARE = 0.5  # of a squared error across that counts, whatever the images' noise
DISTANCE_S = 0.15  # time constant of the distance sensor's mean error [s]
LARGEST_DISTANCE_ERROR = 0.02  # of one reading: more is an outlier [m]

Errors = tuple[float, float, float, float]
"""Error across the tool's axis x, y, along it [m], and of the orientation [rad]."""

Sizes = tuple[float, float, float]
"""Size of an error across, squared [m^2], along the tool's axis [m], of the orientation [rad]."""


class LeadMonitor(Struct, frozen=True, eq=False):
    """Predictions with one lead that wait for their time, and the errors of those before.

    Attributes:
        stamps_ns: times that the object is predicted for, oldest first.
        poses: (6,) of the object in c at these times.
        along: positions of the conveyor at these times [m].
        errors: of each image, newest last, with the time for which images have been compared [ns].
        medians: sizes of the medians of each three errors in a row, newest last.
        seen_ns: exposure of the last image that was compared [ns].
    """

    stamps_ns: tuple[int, ...] = ()
    poses: tuple[Array, ...] = ()
    along: tuple[float, ...] = ()
    errors: tuple[tuple[int, Errors], ...] = ()
    medians: tuple[Sizes, ...] = ()
    seen_ns: int = -(10**18)

    @property
    def lateral(self) -> float:
        """Error of the last second across the object's axis [m]."""
        return _error_sizes(self)[0]

    @property
    def depth(self) -> float:
        """The same along the object's axis [m]."""
        return _error_sizes(self)[1]

    @property
    def angle(self) -> float:
        """The same of the orientation [rad]."""
        return _error_sizes(self)[2]

    @property
    def checked_s(self) -> float:
        """For how long predictions have been compared with images [s]."""
        if not self.errors:
            return 0.0
        return (self.errors[-1][0] - self.errors[0][0]) * 1e-9


class PredictionMonitor(Struct, frozen=True, eq=False):
    """Predictions with several leads, and their errors.

    Attributes:
        leads: one for each lead, the short one first.
        distance: mean error of the conveyor's position with the shortest lead [m].
        recorded_ns: time of the newest prediction that is kept [ns].
    """

    leads: tuple[LeadMonitor, ...] = (LeadMonitor(),) * LEADS
    distance: float = 0.0
    recorded_ns: int = -(10**18)


NO_PREDICTIONS = PredictionMonitor()


def lead_times(blind_s: float) -> tuple[float, float]:
    """Return how far ahead predictions are checked [s].

    Args:
        blind_s: time from the last waypoint before contact to the contact; not finite without one.
    """
    longest = blind_s if math.isfinite(blind_s) else LONGEST_LEAD_S
    return SHORT_LEAD_S, min(max(longest, SHORT_LEAD_S), LONGEST_LEAD_S)


def is_due(monitor: PredictionMonitor, now_ns: int) -> bool:
    """Return whether another prediction is to be kept."""
    return now_ns - monitor.recorded_ns >= SPACING_S * 1e9


def record(
    monitor: PredictionMonitor, now_ns: int, times: Sequence[float], poses: Array, along: Array
) -> PredictionMonitor:
    """Return the monitor with the predictions of one step.

    Args:
        times: (leads,) how far ahead they are [s].
        poses: (leads, 6) of the object in c.
        along: (leads,) of the conveyor unit [m].
    """
    leads = []
    for lead, ahead_s, pose, y in zip(monitor.leads, times, poses, along.tolist(), strict=True):
        keep = slice(-math.ceil((ahead_s + WINDOW_S) / SPACING_S), None)
        stamps = (*lead.stamps_ns, now_ns + round(ahead_s * 1e9))[keep]
        leads.append(_with(lead, stamps, (*lead.poses, pose)[keep], (*lead.along, y)[keep]))
    return PredictionMonitor(tuple(leads), monitor.distance, now_ns)


def forget(monitor: PredictionMonitor) -> PredictionMonitor:
    """Return the monitor without the predictions that wait: the class they assume is over."""
    leads = tuple(_with(lead, (), (), ()) for lead in monitor.leads)
    return PredictionMonitor(leads, 0.0)


def compare_poses(
    monitor: PredictionMonitor, now_ns: int, measured: Sequence[PoseMeasurement]
) -> PredictionMonitor:
    """Return the monitor with the errors of its predictions for the images of one step."""
    if not measured or not monitor.leads[0].stamps_ns:
        return monitor
    leads = monitor.leads
    for each in measured:
        stamp_ns = now_ns - round(each.delay * 1e9)
        along = _along(leads[0], stamp_ns)
        if along is not None:
            leads = tuple(_compared(lead, stamp_ns, each, along) for lead in leads)
    return PredictionMonitor(leads, monitor.distance, monitor.recorded_ns)


def compare_distance(
    monitor: PredictionMonitor, stamp_ns: int, position: float, dt: float
) -> PredictionMonitor:
    """Return the monitor with the error of its shortest prediction for one reading.

    Args:
        position: of the conveyor unit, measured [m].
        dt: time between readings [s].
    """
    expected = _along(monitor.leads[0], stamp_ns)
    if expected is None:
        # The error of a prediction before the gap is no evidence after it.
        return PredictionMonitor(monitor.leads, 0.0, monitor.recorded_ns)
    off = position - expected
    if abs(off) > LARGEST_DISTANCE_ERROR:
        return monitor
    gain = 1.0 - math.exp(-dt / DISTANCE_S)
    mean = monitor.distance + gain * (off - monitor.distance)
    return PredictionMonitor(monitor.leads, mean, monitor.recorded_ns)


def _with(
    lead: LeadMonitor, stamps: tuple[int, ...], poses: tuple[Array, ...], along: tuple[float, ...]
) -> LeadMonitor:
    """Return a lead's monitor with other predictions."""
    return LeadMonitor(stamps, poses, along, lead.errors, lead.medians, lead.seen_ns)


def _place(stamps: tuple[int, ...], stamp_ns: int) -> tuple[int, float]:
    """Return the prediction before a time and the share to the next one; -1 if there is none."""
    i = bisect_right(stamps, stamp_ns) - 1
    if i < 0 or i + 1 >= len(stamps):
        return -1, 0.0
    gap_ns = stamps[i + 1] - stamps[i]
    return (i, (stamp_ns - stamps[i]) / gap_ns) if gap_ns <= LARGEST_GAP_NS else (-1, 0.0)


def _along(lead: LeadMonitor, stamp_ns: int) -> float | None:
    """Return the predicted position of the conveyor at a time [m], None without a prediction."""
    i, share = _place(lead.stamps_ns, stamp_ns)
    if i < 0:
        return None
    return lead.along[i] + share * (lead.along[i + 1] - lead.along[i])


def _compared(
    lead: LeadMonitor, stamp_ns: int, measured: PoseMeasurement, along: float
) -> LeadMonitor:
    """Return a lead's monitor with the error of its prediction for one image.

    Args:
        along: position of the conveyor then, by the shortest prediction [m]. A longer one may not
            know that the conveyor stops, and need not: the distance sensor shows it up to the
            contact.
    """
    i, share = _place(lead.stamps_ns, stamp_ns)
    if i < 0:
        return lead
    pose = lead.poses[i] + share * (lead.poses[i + 1] - lead.poses[i])
    pose[1] += along - (lead.along[i] + share * (lead.along[i + 1] - lead.along[i]))
    R = rotations.exp(pose[3:])
    x, y, z = R.T.dot(measured.position - pose[:3]).tolist()
    turned = math.hypot(*rotations.log(R.T.dot(measured.rotation)).tolist())
    gap_ns = stamp_ns - lead.seen_ns
    is_old = gap_ns > FORGOTTEN_NS
    before, medians = ((), ()) if is_old else (lead.errors[-MOST_ERRORS:], lead.medians)
    # A time without comparison does not make what was checked before it unchecked.
    time_ns = before[-1][0] + min(max(gap_ns, 0), LARGEST_GAP_NS) if before else 0
    oldest = bisect_left(before, (time_ns - round(WINDOW_S * 1e9),))
    errors = (*before[oldest:], (time_ns, (x, y, z, turned)))
    medians = _medians(medians, errors, float(measured.variance[0] + measured.variance[1]))
    return LeadMonitor(lead.stamps_ns, lead.poses, lead.along, errors, medians, stamp_ns)


def _medians(
    medians: tuple[Sizes, ...], errors: tuple[tuple[int, Errors], ...], noise: float
) -> tuple[Sizes, ...]:
    """Return the sizes of the medians of each three errors of a window, of which the last is new.

    Args:
        medians: without the new error.
        noise: variance of its image across the object's axis, x and y together [m^2].
    """
    count = len(errors) - 2
    if count <= 0:
        return ()
    if len(medians) < count - 1:  # the state of an older recording has none
        return tuple([_median(errors[i : i + 3], noise) for i in range(count)])
    return (*medians[len(medians) - count + 1 :], _median(errors[-3:], noise))


def _median(errors: tuple[tuple[int, Errors], ...], noise: float) -> Sizes:
    """Return the size of the medians of three errors, taken component by component.

    What the images' own noise adds across is no error of a prediction.
    """
    (_, (a, b, c, d)), (_, (e, f, g, h)), (_, (k, m, n, o)) = errors
    x, y = sorted((a, e, k))[1], sorted((b, f, m))[1]
    across, depth, turned = _size((x, y, sorted((c, g, n))[1], sorted((d, h, o))[1]))
    return max(across - NOISE_SHARE * noise, LEAST_SHARE * across), depth, turned


def _size(error: Errors) -> Sizes:
    x, y, z, turned = error
    return x * x + y * y, abs(z), abs(turned)


# The two leads of a step, each read several times while the decision is due.
@lru_cache(maxsize=4)
def _error_sizes(lead: LeadMonitor) -> tuple[float, float, float]:
    """Return the size of the errors of the window: across, along [m], orientation [rad].

    The quantile of medians counts noise less than a deviation that lasts. Plain floats: numpy's
    median alone cost 50 us.
    """
    sizes = lead.medians or tuple([_size(error) for _, error in lead.errors])
    if not sizes:
        return 0.0, 0.0, 0.0
    place = min(round(QUANTILE * len(sizes)), len(sizes) - 1)
    lateral, depth, angle = [sorted(column)[place] for column in zip(*sizes, strict=True)]
    return math.sqrt(lateral), depth, angle
