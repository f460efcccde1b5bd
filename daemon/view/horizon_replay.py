"""What a recorded step foresaw: its horizon, made again from its inputs, in a process of its own.

Law of this file: a recording holds only a digest of each horizon, but everything that led to it;
so the steps are made again, as ``linemate replay`` does. Each says whether its digest is the
recorded one; where another version of the program foresaw from another place, nothing is shown.
``python -m linemate.daemon.view.horizon_replay FILE`` prints one JSON line a step.
"""

import json
import math
import os
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.recording import reader, step_replay
from linemate.daemon.recording.step_codec import digest

SHOWN: Final = 8
SPACING_NS: Final = 30_000_000
"""Between two steps that are shown [ns]; as ``tape.SPACING_NS``."""

CLOSE: Final = 1e-3
"""Between the recorded pose and the one made again, for the horizon to be shown [m]."""


@dataclass(frozen=True, slots=True)
class Foreseen:
    """What one step foresaw.

    Attributes:
        k: number of the step.
        exact: all bits are the recorded ones.
        ahead_ms: how far the last point lies ahead [ms].
        points: evenly spread positions of the tcp in base [m].
    """

    k: int
    exact: bool
    ahead_ms: float
    points: list[list[float]]


def foreseen(path: Path) -> Iterator[Foreseen]:
    """Return what the steps of a recording foresaw, as far as it can be made again.

    Raises:
        UnreadableRecordingError, ReplayError: it cannot be replayed.
    """
    last_ns = None
    pieces = step_replay.with_cycle(reader.pieces(path))
    for record, outputs, parameters in step_replay.replay_outputs(pieces):
        stamp_ns, horizon = record.inputs.stamp_ns, outputs.horizon
        if last_ns is not None and 0 <= stamp_ns - last_ns < SPACING_NS:
            continue
        if horizon is None or math.dist(outputs.target[:3], record.outputs["target"][:3]) > CLOSE:
            continue
        last_ns = stamp_ns
        exact = digest(horizon) == record.outputs.get("horizon")
        ahead_ms = round(1e3 * parameters.cycle_s * (len(horizon) - 1))
        points = _points(horizon, parameters.tracker.reference.nominal)
        yield Foreseen(record.inputs.k, exact, ahead_ms, points)


def _points(horizon: Array, nominal: Array) -> list[list[float]]:
    chosen = np.linspace(0, len(horizon) - 1, min(SHOWN, len(horizon))).round().astype(int)
    points: list[list[float]] = (horizon[chosen, :3] @ nominal.T).round(5).tolist()
    return points


def main() -> int:
    """Print what a recording's steps foresaw, as JSON lines."""
    os.nice(10)
    for one in foreseen(Path(sys.argv[1])):
        told = [one.k, one.exact, one.ahead_ms, one.points]
        print(json.dumps(told, separators=(",", ":")), flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
