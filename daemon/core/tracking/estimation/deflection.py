"""Deflection of the clamped tool as a measurement of the object."""

import numpy as np
from msgspec.structs import replace

from linemate.daemon.core.tracking.conveyor import PositionMeasurement
from linemate.daemon.core.tracking.merge import ALONG
from linemate.daemon.core.tracking.observation import PoseMeasurement
from linemate.daemon.core.tracking.touch import compliance, held_bolts
from linemate.daemon.core.tracking.tracker_state import Tracker, TrackerState

# The offset of the compliance follows across; the screws turn the object by a milliradian at once.
_SLOWER = np.array((4.0, 4.0, 4.0, 0.0625, 0.0625, 0.0625))
_TRANSLATIONS = np.array((4.0, 4.0, 4.0, 0.0, 0.0, 0.0))
_ROTATIONS = np.array((0.0, 0.0, 0.0, 1.0, 1.0, 1.0))
# Variance of what a contact that can slide shows across the tool's axis and about it: nothing.
_SLIDES = np.array((1.0, 1.0, 0.0, 0.0, 0.0, 1.0))
# Times the sigma of a deflection that follows an oscillation which it drives.
DRIVEN_INFLATION = 6.0


def felt_row(
    tracker: Tracker, state: TrackerState, row: PositionMeasurement, more: float
) -> PositionMeasurement:
    """Return a deflection along the conveyor with what is known of the object in contact.

    Args:
        more: variance that an oscillation adds [m^2].
    """
    complied = state.compliance
    return replace(
        row,
        variance=_inflation(state) * row.variance + more,
        is_firm=complied.is_firm,
        complied=complied.offset[ALONG],
        pushed=held_bolts.pushed(state.leaning, state.poses[0], ALONG)
        if any(state.leaning)
        else 0.0,
        ringing=compliance.ringing(complied, tracker.compliance),
    )


def felt_pose(
    tracker: Tracker, state: TrackerState, measured: PoseMeasurement, oscillation: float
) -> PoseMeasurement:
    """Return a deflection as the filter across the conveyor takes it: slowly.

    A target that followed it at once would drive a body that gives way. What the offset of the
    compliance has taken up is no error of the estimate: else the target moved by it twice.

    Args:
        oscillation: variance that it adds to a deflection [m^2].
    """
    position = measured.position - np.array(state.compliance.offset)
    slides = 0.0 if tracker.settings.tactile.holds else _SLIDES
    if state.compliance.is_firm:
        return replace(measured, position=position, variance=measured.variance + slides)
    factor = tracker.settings.tactile.compliance**2
    slower = _inflation(state) * _SLOWER
    # The torque swings with the force: it would turn the target, which drove the swing.
    share = oscillation / float(measured.variance[:3].mean())
    turned = share * _ROTATIONS * measured.variance
    variance = factor * (slower * measured.variance + _TRANSLATIONS * oscillation + turned)
    return replace(measured, position=position, variance=variance + slides)


def _inflation(state: TrackerState) -> float:
    """Return the factor of a deflection's variance: large in a contact that drives its object."""
    return DRIVEN_INFLATION**2 if state.compliance.driven else 1.0
