"""linemate in Python: runs and recordings as arrays, own classifiers, poses handed to a daemon.

``docs/python.md`` describes every name. A name is imported on its first use, so that the programs,
which are subpackages, start with nothing of it.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from linemate.daemon.core.tracking.conveyor import (
        Classifier,
        ConveyorEstimate,
        Motion,
        PositionMeasurement,
    )
    from linemate.daemon.transport.client import Client
    from linemate.daemon.transport.follow import Follower, follow
    from linemate.simulators.harness.cell.plugins import PluginError, Predictor
    from linemate.simulators.harness.research.run_arrays import Run
    from linemate.simulators.harness.research.simulation import replay, simulate

__all__ = [
    "Classifier",
    "Client",
    "ConveyorEstimate",
    "Follower",
    "Motion",
    "PluginError",
    "PositionMeasurement",
    "Predictor",
    "Run",
    "follow",
    "replay",
    "simulate",
]

_CONVEYOR = "linemate.daemon.core.tracking.conveyor"
_RESEARCH = "linemate.simulators.harness.research"
_MODULES = {
    "Classifier": _CONVEYOR,
    "ConveyorEstimate": _CONVEYOR,
    "Motion": _CONVEYOR,
    "PositionMeasurement": _CONVEYOR,
    "Client": "linemate.daemon.transport.client",
    "Follower": "linemate.daemon.transport.follow",
    "follow": "linemate.daemon.transport.follow",
    "PluginError": "linemate.simulators.harness.cell.plugins",
    "Predictor": "linemate.simulators.harness.cell.plugins",
    "Run": f"{_RESEARCH}.run_arrays",
    "replay": f"{_RESEARCH}.simulation",
    "simulate": f"{_RESEARCH}.simulation",
}


def __getattr__(name: str) -> Any:
    """Import a public name on its first use."""
    module = _MODULES.get(name)
    if module is None:
        raise AttributeError(f"module 'linemate' has no attribute {name!r}")
    value = getattr(import_module(module), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    """Return the public names."""
    return sorted({*globals(), *__all__})
