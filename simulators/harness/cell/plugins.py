"""Classifiers and predictors of other packages, found by their entry points.

Entry points of the group ``linemate.classifiers`` name a ``ClassifierFactory``, those of
``linemate.predictors`` a ``PredictorFactory``. A name ``module:attribute`` needs no entry point.

Invariants:
    Only simulated runs use them. The service ``linemated`` loads no code of others.
    A name of a shipped variant is never replaced.
"""

from collections.abc import Callable, Sequence
from importlib import import_module
from importlib.metadata import entry_points
from typing import Any, Protocol

import numpy as np

from linemate.daemon.core.horizon import Array
from linemate.daemon.core.parameters import Parameters, with_classifier
from linemate.daemon.core.tracking.conveyor import Classifier, ConveyorEstimate, PositionMeasurement
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import ConveyorClasses
from linemate.simulators.harness.cell.plugin_names import CLASSIFIERS, PREDICTORS


class Predictor(Protocol):
    """Prediction of the object's way along the conveyor."""

    def predict_positions(self, estimate: ConveyorEstimate, times: Array) -> Array:
        """Return the object's positions (m,) [m] at ``times`` (m,) from now [s]."""


ClassifierFactory = Callable[[ConveyorClasses, TrackingSettings], Classifier]
PredictorFactory = Callable[[ConveyorClasses, TrackingSettings], Predictor]
Change = Callable[[Parameters], Parameters]


class PluginError(ValueError):
    """A classifier or a predictor that cannot be used; the message says why."""


class PredictedClassifier:
    """A classifier whose prediction is made by a predictor.

    Args:
        classifier: gives estimate and class.
        predictor: gives the future positions.
    """

    def __init__(self, classifier: Classifier, predictor: Predictor) -> None:
        self._classifier = classifier
        self._predictor = predictor

    def initial(self, position: float) -> Any:
        """Return the state at a first reading of the distance sensor [m]."""
        return self._classifier.initial(position)

    def advance(self, state: Any, measurements: Sequence[PositionMeasurement], dt: float) -> Any:
        """Return the state ``dt`` seconds later, corrected by the measurements."""
        return self._classifier.advance(state, measurements, dt)

    def announce_stop(self, state: Any) -> Any:
        """Return the state as the line announces a stop."""
        return self._classifier.announce_stop(state)

    def predict_positions(self, state: Any, times: Array) -> Array:
        """Return the predictor's positions (m,) [m] at ``times`` from now [s].

        Raises:
            PluginError: they have another shape, or are not finite.
        """
        estimate = self._classifier.estimate(state)
        positions = np.asarray(self._predictor.predict_positions(estimate, times), dtype=np.float64)
        if positions.shape != np.shape(times) or not np.isfinite(positions).all():
            name = type(self._predictor).__name__
            raise PluginError(
                f"{name}.predict_positions: shape {positions.shape}, or a number is not finite. "
                f"Return {np.shape(times)} finite positions."
            )
        return positions

    def predict_sway(self, state: Any, times: Array) -> Array:
        """Return the part (m,) of these positions that is the body's sway [m]."""
        return self._classifier.predict_sway(state, times)

    def estimate(self, state: Any) -> ConveyorEstimate:
        """Return the estimate of the conveyor now."""
        return self._classifier.estimate(state)


def change_of(name: str) -> Change:
    """Return what puts the named classifier or predictor into compiled parameters.

    Raises:
        PluginError: there is none, or it cannot be imported.
    """
    classifiers, predictors = (
        {entry.name: entry for entry in entry_points(group=group)}
        for group in (CLASSIFIERS, PREDICTORS)
    )
    try:
        if name in classifiers:
            return classified_by(classifiers[name].load())
        if name in predictors:
            return predicted_by(predictors[name].load())
        module, _, attribute = name.partition(":")
        factory = getattr(import_module(module), attribute)
    except (ImportError, AttributeError, ValueError) as error:
        raise PluginError(f"{name}: {error}") from error
    return changed_by(factory)


def changed_by(factory: Any) -> Change:
    """Return what puts a factory's classifier or predictor into compiled parameters.

    A result with ``advance`` counts as a classifier, another one as a predictor.
    """

    def change(parameters: Parameters) -> Parameters:
        plugin = _plugin_of(factory, parameters)
        by = classified_by if hasattr(plugin, "advance") else predicted_by
        return by(lambda _conveyor, _settings: plugin)(parameters)

    return change


def classified_by(factory: ClassifierFactory) -> Change:
    """Return what puts a factory's classifier into compiled parameters."""

    def change(parameters: Parameters) -> Parameters:
        return with_classifier(parameters, _plugin_of(factory, parameters))

    return change


def predicted_by(factory: PredictorFactory) -> Change:
    """Return what puts a factory's predictor next to the classifier of compiled parameters."""

    def change(parameters: Parameters) -> Parameters:
        inner = parameters.tracker.classifier
        return with_classifier(
            parameters, PredictedClassifier(inner, _plugin_of(factory, parameters))
        )

    return change


def _plugin_of(factory: Any, parameters: Parameters) -> Any:
    tracker = parameters.tracker
    try:
        return factory(tracker.task.conveyor, tracker.settings)
    except TypeError as error:
        name = getattr(factory, "__name__", repr(factory))
        raise PluginError(f"{name}(conveyor, settings): {error}") from error
