"""Rows whose cells had their arm measured: poses by a laser tracker, and `linemate identify-arm`.

Invariants:
    The plant is that of the row without it, and so are the seeds.
    Each seed's arm is measured before its run, and only through the tracker's noise.
"""

from linemate.daemon.identification.geometry.arm_geometry import MeasuredArm, identify_geometry
from linemate.simulators.harness.setup import Setup, laid_over
from linemate.simulators.lab.commissioning import arm_tracker

SUFFIX = "-measured"
ROWS = {f"{name}{SUFFIX}": name for name in ("plant-floor", "plant-floor-harsh")}
"""Row whose plant it has, by name."""
WHAT = "the same, the arm's geometry identified from poses of a laser tracker"


def identified(setup: Setup, seed: int) -> Setup:
    """Return a setup whose daemon has the geometry of its arm.

    Args:
        seed: of the run, whose cell it is unless the scenario states its own.
    """
    poses = arm_tracker.measure(setup, seed)
    geometry = identify_geometry(MeasuredArm(setup.task, setup.urdf, setup.control), poses)
    return laid_over(setup, geometry.overlay)
