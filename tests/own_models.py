"""Classifier and predictors as a researcher would write them, each in a file of one's own."""

from typing import Any

import numpy as np

from linemate import ConveyorEstimate


class ConstantSpeed:
    """Predict that the object keeps its speed."""

    def __init__(self, _conveyor: Any, _settings: Any) -> None:
        self.calls = 0

    def predict_positions(self, estimate: ConveyorEstimate, times: Any) -> Any:
        return estimate.position + estimate.speed * times


class NotANumber(ConstantSpeed):
    """Predict nothing that can be used."""

    def predict_positions(self, estimate: ConveyorEstimate, times: Any) -> Any:
        return np.full(np.shape(times), np.nan)


class TakesNothing:
    """A class that is no factory."""
