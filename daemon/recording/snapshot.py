"""Encode the state of a step as bytes, and decode it, bit for bit.

A recording can be replayed from any step that has a snapshot.

Invariants:
    A float keeps its 64 bits and an array its order in memory.
    Only the classes in ``_PARTS`` are made, so that bytes of unknown origin can do no harm.
"""

import importlib
from collections.abc import Callable
from enum import Enum
from functools import cache
from typing import Any, Literal

import msgpack
import numpy as np
from msgspec import Struct

from linemate.daemon.core.step_state import StepState

VERSION = 1

_ROOT = "linemate.daemon.core."

# Name in a recording: module below ``_ROOT`` and class. A name in a recording never changes.
_PARTS = {
    "control.controller:ControlState": "control.controller:ControlState",
    "control.dead_time:DriftState": "control.dead_time:DriftState",
    "control.friction:FrictionState": "control.friction:FrictionState",
    "control.limits:GateState": "control.command_limiter:LimiterState",
    "control.windup:WindupState": "control.windup:WindupState",
    "followed_poses:FollowedPoses": "followed_poses:FollowedPoses",
    "step:State": "step_state:StepState",
    "tracking.bolt_search:BoltSearch": "tracking.touch.bolt_search:BoltSearch",
    "tracking.classifier_bank:BankState": "tracking.classifiers.bank_model:BankState",
    "tracking.classifier_imm:ImmState": "tracking.classifiers.classifier_imm:ImmState",
    "tracking.classifier_rule:RuleState": "tracking.classifiers.classifier_rule:RuleState",
    "tracking.classifier_rule:Trial": "tracking.classifiers.classifier_rule:TentativeClass",
    "tracking.compliance:Compliance": "tracking.touch.compliance:Compliance",
    "tracking.felt_drift:FeltDrift": "tracking.classifiers.felt_drift:FeltDrift",
    "tracking.force_jump:ForceOffset": "tracking.touch.force_jump:ForceOffset",
    "tracking.contact:Feeling": "tracking.touch.contact:ContactState",
    "tracking.conveyor:Motion": "tracking.conveyor:Motion",
    "tracking.conveyor:Source": "tracking.conveyor:Source",
    "tracking.go_no_go:ClockRamp": "tracking.go_no_go.clock_ramp:ClockRamp",
    "tracking.go_no_go:GoState": "tracking.go_no_go.decision:GoState",
    "tracking.go_no_go:LeadMonitor": "tracking.estimation.prediction_error:LeadMonitor",
    "tracking.go_no_go:Order": "tracking.go_no_go.decision:GoOrder",
    "tracking.go_no_go:PredictionMonitor": "tracking.estimation.prediction_error:PredictionMonitor",
    "tracking.go_no_go:Reason": "tracking.go_no_go.decision:Reason",
    "tracking.go_no_go:TargetShift": "tracking.go_no_go.target_shift:TargetShift",
    "tracking.firmness:Firmness": "tracking.touch.firmness:Firmness",
    "tracking.firmness:Swing": "tracking.touch.firmness:Swing",
    "tracking.guide:Guide": "tracking.classifiers.bank_model:Guide",
    "tracking.force_sign:ForceSign": "tracking.touch.force_sign:ForceSign",
    "tracking.guard:Search": "tracking.touch.guard:ContactSearch",
    "tracking.guard:TouchedProgramme": "tracking.touch.guard:TouchedProgramme",
    "tracking.hypotheses:Bank": "tracking.classifiers.onset_bank:OnsetBank",
    "tracking.hypotheses:Verdict": "tracking.classifiers.onset_bank:OnsetPosterior",
    "tracking.linear_axis:AxisPlan": "tracking.linear_axis:AxisPlan",
    "tracking.noise:MeasuredNoise": "tracking.classifiers.distance.measured_noise:MeasuredNoise",
    "tracking.observation:History": "tracking.observation:History",
    "tracking.observation:Sighting": "tracking.observation:PoseMeasurement",
    "tracking.ramp_check:StartCheck": "tracking.classifiers.start_check:StartCheck",
    "tracking.sway:SwayBank": "tracking.classifiers.sway_bank:SwayBank",
    "tracking.sway:UnitEstimate": "tracking.classifiers.unit_estimate:UnitEstimate",
    "tracking.tare:Tare": "tracking.touch.tare:Tare",
    "tracking.tare:Turning": "tracking.touch.tare:Turning",
    "tracking.task:Gate": "tracking.task:Gate",
    "tracking.tracker:TrackerState": "tracking.tracker_state:TrackerState",
    "tracking.transverse:BodySway": "tracking.across.body_sway:BodySway",
    "tracking.transverse:TransverseState": "tracking.across.transverse_state:TransverseState",
    "way_home:HomePath": "way_home:HomePath",
}

# By name in a recording: fields of older recordings that a state has no more.
_DROPPED = {"tracking.go_no_go:LeadMonitor": {"lateral", "depth", "angle"}}

# By name in a recording: fields whose name in a recording is not the present one.
_FIELDS = {
    "tracking.tracker:TrackerState": {
        "belief": "conveyor",
        "across": "transverse",
        "sightings": "first_poses",
        "feeling": "contact_state",
        "seen_ns": "pose_ns",
    },
    "tracking.transverse:TransverseState": {
        "refused": "rejected",
        "paces": "frequency_factors",
        "scatter": "nis",
    },
    "control.controller:ControlState": {
        "smooth": "past_poses",
        "passed": "past_joints",
        "desired": "joints",
        "wanted": "poses",
        "gate": "limiter",
    },
    "tracking.classifier_bank:BankState": {
        "bank": "changes",
        "pushes": "impulses",
        "omega": "impulse_omega",
        "pace": "ripple_factor",
        "since": "class_age",
        "refused": "rejected",
        "push": "impulse",
        "odds": "change_odds",
        "push_odds": "impulse_odds",
        "trial_s": "tentative_s",
        "is_spent": "is_expired",
        "check": "start_check",
    },
    "tracking.classifier_imm:ImmState": {
        "refused": "rejected",
        "trial_s": "tentative_s",
        "check": "start_check",
    },
    "tracking.classifier_rule:RuleState": {
        "w": "monitor",
        "W": "monitor_P",
        "since": "class_age",
        "refused": "rejected",
        "wild": "outliers",
        "trial": "tentative",
        "check": "start_check",
    },
}

_ARRAYS = {"<f8", "<i8", "|b1", "<i4", "<c16"}


class SnapshotError(ValueError):
    """Bytes that are no state, or one of another version of the program."""


def encode(state: StepState) -> bytes:
    """Make bytes of a state.

    Raises:
        SnapshotError: there is something in it that cannot be kept.
    """
    try:
        packed: bytes = msgpack.packb([VERSION, _plain(state)])
    except (TypeError, ValueError, OverflowError) as error:
        raise SnapshotError(f"the state cannot be kept: {error}") from error
    return packed


def decode(data: bytes) -> StepState:
    """Make a state of bytes.

    Raises:
        SnapshotError: they are none, or their parts are not those of this version.
    """
    try:
        version, tree = msgpack.unpackb(data, strict_map_key=False)
        if version != VERSION:
            raise SnapshotError(f"version {version!r} of a state is not known")
        state = _rebuilt(tree)
    except (ValueError, TypeError, LookupError, AttributeError, ImportError) as error:
        if isinstance(error, SnapshotError):
            raise
        raise SnapshotError(f"not a state: {type(error).__name__}: {error}") from error
    except msgpack.UnpackException as error:
        raise SnapshotError(f"not a state: {error}") from error
    if not isinstance(state, StepState):
        raise SnapshotError(f"not a state: {type(state).__name__}")
    return state


def _plain(value: Any) -> Any:
    """Return a value as msgpack knows it: what is not plain becomes a tagged list."""
    # Enumerations first: those of text are text as well.
    if isinstance(value, Enum):
        return ["e", _name(type(value)), value.name]
    if isinstance(value, np.generic):
        return value.item()
    if value is None or isinstance(value, (bool, int, float, str, bytes)):
        return value
    encode = _ENCODERS.get(type(value), _object)
    return encode(value)


def _object(value: Any) -> list[Any]:
    if not isinstance(value, Struct):
        raise TypeError(f"{type(value).__name__} has no place in a state")
    stored = _name(type(value))
    current = _FIELDS.get(stored, {})
    names = {now: name for name, now in current.items()}
    own = {
        names.get(field, field): _plain(getattr(value, field)) for field in value.__struct_fields__
    }
    return ["o", stored, own]


def _array(value: np.ndarray[Any, Any]) -> list[Any]:
    if value.dtype.str not in _ARRAYS:
        raise TypeError(f"an array of {value.dtype} has no place in a state")
    # A sum may depend on the order in memory, in its last bit.
    in_columns = value.flags.f_contiguous and not value.flags.c_contiguous
    order: Literal["C", "F"] = "F" if in_columns else "C"
    return ["a", value.dtype.str, list(value.shape), order, value.tobytes(order=order)]


def _rebuilt(tree: Any) -> Any:
    if not isinstance(tree, list):
        return tree
    return _MAKERS[tree[0]](*tree[1:])


def _made_array(dtype: str, shape: list[int], order: str, data: bytes) -> np.ndarray[Any, Any]:
    if dtype not in _ARRAYS or order not in {"C", "F"}:
        raise ValueError(f"an array of {dtype!r} in order {order!r}")
    flat = np.frombuffer(data, dtype=dtype)
    return flat.reshape(shape, order="F" if order == "F" else "C").copy(order="K")


def _made_object(name: str, own: dict[str, Any]) -> Any:
    kind = _kind(name)
    if not issubclass(kind, Struct):
        raise TypeError(f"{name} is no part of a state")
    current, dropped = _FIELDS.get(name, {}), _DROPPED.get(name, ())
    return kind(**{current.get(key, key): _rebuilt(own[key]) for key in own if key not in dropped})


def _made_member(name: str, member: str) -> Any:
    kind = _kind(name)
    if not issubclass(kind, Enum):
        raise TypeError(f"{name} is no enumeration")
    return kind[member]


@cache
def _name(kind: type[Any]) -> str:
    place = f"{kind.__module__.removeprefix(_ROOT)}:{kind.__qualname__}"
    for name, part in _PARTS.items():
        if part == place:
            return name
    raise TypeError(f"{kind.__module__}.{kind.__qualname__} has no place in a state")


@cache
def _kind(name: str) -> type[Any]:
    if name not in _PARTS:
        raise ValueError(f"{name!r} is no part of a state")
    module, _, own = _PARTS[name].partition(":")
    kind: type[Any] = getattr(importlib.import_module(_ROOT + module), own)
    return kind


_ENCODERS: dict[type[Any], Callable[[Any], list[Any]]] = {
    tuple: lambda items: ["t", *map(_plain, items)],
    list: lambda items: ["l", *map(_plain, items)],
    frozenset: lambda items: ["f", *map(_plain, sorted(items, key=str))],
    dict: lambda items: ["d", *([_plain(key), _plain(item)] for key, item in items.items())],
    np.ndarray: _array,
}

_MAKERS: dict[str, Callable[..., Any]] = {
    "t": lambda *items: tuple(map(_rebuilt, items)),
    "l": lambda *items: list(map(_rebuilt, items)),
    "f": lambda *items: frozenset(map(_rebuilt, items)),
    "d": lambda *pairs: {_rebuilt(key): _rebuilt(item) for key, item in pairs},
    "a": _made_array,
    "o": _made_object,
    "e": _made_member,
}
