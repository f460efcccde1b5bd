"""Margins of the task to the limits of tcp and axes, as figures."""

import math
from collections.abc import Iterator

from linemate.daemon.commissioning.whole_check import CheckedConfig
from linemate.daemon.identification.outcome import Estimate, ReportLine


def margin_lines(checked: CheckedConfig) -> Iterator[ReportLine]:
    """Yield each largest speed with its limit, and each margin to a position limit."""
    for peak in checked.peaks:
        is_length = peak.name in {"tcp", "E1"}
        unit = "m/s" if is_length else "deg/s"
        scale = 1.0 if is_length else math.degrees(1.0)
        basis = f"limit {scale * peak.limit:.4g} {unit}, at {peak.at_s:.1f} s of the task"
        yield ReportLine(f"{peak.name} speed", unit, scale, Estimate(peak.speed, 0.0, basis))
        if peak.margin != math.inf:
            unit = "m" if is_length else "deg"
            basis = "to the nearer end of the axis along the task"
            yield ReportLine(f"{peak.name} margin", unit, scale, Estimate(peak.margin, 0.0, basis))
