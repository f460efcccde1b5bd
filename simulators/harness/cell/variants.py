"""Variants of the method: the full chain with one part removed or replaced.

Invariants:
    A variant changes the daemon's settings and nothing else.
    A variant of another package changes the classifier or the prediction and nothing else.
    ``oracle`` also gives the tracker the true future: the bound of prediction.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.tracking.settings import ClassifierKind, MergeSettings, TrackingSettings
from linemate.simulators.harness.cell.plugin_names import is_plugin, names

if TYPE_CHECKING:
    from linemate.simulators.harness.cell.plugins import Change

Settings = tuple[TrackingSettings, ControlSettings]
Transformation = Callable[[TrackingSettings, ControlSettings], Settings]

_AT_ONCE_S = 1e-3
"""A time constant far below a cycle: the new plan is taken up as fast as the merge can."""


class SetupError(ValueError):
    """What was asked for cannot be run; the message says why."""


class UnknownVariantError(SetupError):
    """No such variant."""

    def __init__(self, name: str) -> None:
        super().__init__(f"no variant {name!r}; there are {', '.join(known())}")
        self.name = name


def _tracking(**changed: Any) -> Transformation:
    return lambda tracking, control: (replace(tracking, **changed), control)


def _control(**changed: Any) -> Transformation:
    return lambda tracking, control: (tracking, replace(control, **changed))


ORACLE = "oracle"
"""The variant whose prediction is the plant's true future; ``foresight`` gives it."""

VARIANTS: dict[str, Transformation] = {
    ORACLE: _tracking(),
    "default": _tracking(),
    "bank": _tracking(classifier=ClassifierKind.BANK, mixture=True),
    "imm": _tracking(classifier=ClassifierKind.IMM, mixture=True),
    "rule": _tracking(classifier=ClassifierKind.RULE, mixture=False),
    "no-classes": _tracking(classifier=ClassifierKind.NONE, mixture=False),
    "no-prediction": _tracking(predict=False),
    "no-feedforward": _control(feed_forward=False),
    "no-damping": _control(damping=False),
    "no-swing": _tracking(swing=()),
    "no-blend": _tracking(merge=MergeSettings(*[_AT_ONCE_S] * 3)),
}


def apply(name: str, tracking: TrackingSettings, control: ControlSettings) -> Settings:
    """The settings of a variant; a classifier of another package keeps them.

    Raises:
        UnknownVariantError: no such variant.
    """
    transform = VARIANTS.get(name)
    if transform is not None:
        return transform(tracking, control)
    if not is_plugin(name):
        raise UnknownVariantError(name)
    return tracking, control


def change_of(name: str) -> "Change | None":
    """Return what a variant changes in compiled parameters, None if nothing.

    Raises:
        SetupError: the classifier or predictor of another package cannot be used.
    """
    if name in VARIANTS:
        return None
    from linemate.simulators.harness.cell import plugins  # numpy is not for every command

    try:
        return plugins.change_of(name)
    except plugins.PluginError as error:
        raise SetupError(str(error)) from error


def known() -> tuple[str, ...]:
    """Return the names of all variants, those of other packages last."""
    return (*VARIANTS, *(name for name in names() if name not in VARIANTS))


def is_known(name: str) -> bool:
    """Return whether a name is a variant, shipped or of another package."""
    return name in VARIANTS or is_plugin(name)
