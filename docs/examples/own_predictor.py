"""Example: an own predictor, judged against the default, on its own recording.

A script with cells: editors run each block below ``# %%`` as a cell of a notebook.
"""

# %% A predictor is a class of one's own. This one knows no stop.
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import linemate


class ConstantSpeed:
    """The object keeps its speed."""

    def __init__(self, conveyor: Any, settings: Any) -> None:
        """Take the conveyor's classes and the settings of tracking; this one needs neither."""

    def predict_positions(self, estimate: linemate.ConveyorEstimate, times: Any) -> Any:
        """Return the positions (m,) [m] at ``times`` (m,) from now [s]."""
        return estimate.position + estimate.speed * times


# %% Two runs of the same seed. The conveyor stops at 5.1 s. A run takes some seconds.
short = {"scenario.duration_s": 5.6}
folder = Path(tempfile.mkdtemp())
recording = folder / "default.mcap"
default = linemate.simulate(seed=1, parameters=short, record=recording)
own = linemate.simulate(seed=1, parameters=short, classifier=ConstantSpeed)

# %% The truth stands next to the estimate: arrays in SI units, a row a telegram.
for name, run in (("default", default), ("own", own)):
    plan, _ = run.errors()["plan"]
    stop = run.t > 5.13
    print(
        f"{name}: committed pose off the estimate in the stop {1e3 * np.nanmax(plan[stop]):.2f} mm"
    )

# %% The default's recording, replayed: first unchanged, then with the own predictor.
same = linemate.replay(recording)
other = linemate.replay(recording, classifier=ConstantSpeed)
apart = np.linalg.norm(other.estimate["target"][:, :3] - same.estimate["target"][:, :3], axis=1)
print(f"identical: {same.is_identical}; the targets part by {1e3 * np.nanmax(apart):.1f} mm")
