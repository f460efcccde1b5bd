"""Predicted horizons of a recording's steps, computed again from their inputs.

A recording holds only a digest of each horizon. ``python -m linemate.daemon.view.horizon_replay
FILE`` prints a line of JSON for each shown step, in a process of its own.

Invariants:
    * A horizon is exact if its digest is the recorded one.
    * A step whose pose differs from the recorded one by more than TOLERANCE_M is left out.
"""

import json
import math
import os
import sys
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.recording import reader, step_replay
from linemate.daemon.recording.step_codec import digest
from linemate.daemon.view.recorded_run import SPACING_NS

MAX_POINTS: Final = 8
TOLERANCE_M: Final = 1e-3
NICE: Final = 10


class PredictedHorizon(NamedTuple):
    """The horizon of one step.

    Attributes:
        k: Number of the step.
        exact: Whether all bits are the recorded ones.
        ahead_ms: Time from the step to the last point [ms].
        points: Evenly spaced positions of the tcp in base [m].
    """

    k: int
    exact: bool
    ahead_ms: float
    points: list[list[float]]


def predicted_horizons(path: Path) -> Iterator[PredictedHorizon]:
    """Yield the horizons of a recording's steps, as far as they can be computed again.

    Raises:
        UnreadableRecordingError, ReplayError: It cannot be replayed.
    """
    last_ns = None
    pieces = step_replay.with_cycle(reader.pieces(path))
    for record, outputs, parameters in step_replay.replay_outputs(pieces):
        stamp_ns, horizon = record.inputs.stamp_ns, outputs.horizon
        if last_ns is not None and 0 <= stamp_ns - last_ns < SPACING_NS:
            continue
        if horizon is None or not _is_near(outputs.target, record.outputs["target"]):
            continue
        last_ns = stamp_ns
        is_exact = digest(horizon) == record.outputs.get("horizon")
        ahead_ms = round(1e3 * parameters.cycle_s * (len(horizon) - 1))
        points = _points(horizon, parameters.tracker.reference.nominal)
        yield PredictedHorizon(record.inputs.k, is_exact, ahead_ms, points)


def _is_near(a: Sequence[float], b: Sequence[float]) -> bool:
    return math.dist(a[:3], b[:3]) <= TOLERANCE_M


def _points(horizon: Array, nominal: Array) -> list[list[float]]:
    chosen = np.linspace(0, len(horizon) - 1, min(MAX_POINTS, len(horizon))).round().astype(int)
    points: list[list[float]] = (horizon[chosen, :3] @ nominal.T).round(5).tolist()
    return points


def main() -> int:
    """Print the horizons as JSON lines."""
    os.nice(NICE)
    for predicted in predicted_horizons(Path(sys.argv[1])):
        print(json.dumps(predicted, separators=(",", ":")), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
