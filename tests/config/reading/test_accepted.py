"""Values that msgspec fills: none that pydantic would refuse or fill otherwise."""

import json
from dataclasses import asdict
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.reading import accepted, judged
from linemate.daemon.config.reading.complaints import Path
from linemate.daemon.config.settings import (
    CameraSettings,
    Config,
    DistanceSettings,
    ForceTorqueSettings,
    ProductionSettings,
    RsiSettings,
)
from linemate.daemon.config.task_file import parse

CONFIG = Config(
    "wheel.yaml",
    rsi=RsiSettings(constants={"a": 1, "b": True, "c": 0.5, "d": "e"}),
    distance=DistanceSettings(can={"interface": "virtual", "channel": 1}),
    camera=CameraSettings(),
    force_torque=ForceTorqueSettings("socket://host:1"),
    production=ProductionSettings({"a": "wheel.yaml"}),
)
TASK = parse((DAEMON_DATA / "wheel.yaml").read_bytes(), "wheel.yaml")
SMALL = (CONFIG.rsi, CONFIG.production, CONFIG.distance, CONFIG.tracking.sway, CONFIG.control)
PLAIN: tuple[tuple[type[Any], Any], ...] = tuple(
    (type(value), json.loads(json.dumps(asdict(value)))) for value in (*SMALL, TASK, CONFIG)
)
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3) | st.integers(-(10**30), 10**30),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text("abe1. ", max_size=6) | st.sampled_from(["rsi", "egm", "bank", "absolute", "x" * 5000]),
    st.lists(st.integers(0, 2) | st.none() | st.text("a", max_size=1), max_size=8),
    st.dictionaries(st.text("ab", max_size=2), st.integers(0, 2) | st.text("a"), max_size=3),
)


def places(value: Any, path: Path = ()) -> list[Path]:
    """Return the path of each value."""
    parts: Any = enumerate(value) if isinstance(value, list) else ()
    parts = value.items() if isinstance(value, dict) else parts
    return [path, *(place for key, part in parts for place in places(part, (*path, key)))]


def changed(value: Any, place: Path, new: Any, how: str) -> Any:
    """Return plain values with one replaced, removed, or with another key next to it."""
    value = json.loads(json.dumps(value))
    if not place:
        return new
    at = value
    for part in place[:-1]:
        at = at[part]
    if how == "remove":
        del at[place[-1]]
    elif how == "add" and isinstance(at, dict):
        at["unheard_of"] = new
    else:
        at[place[-1]] = new
    return value


def test_whole_files_are_filled_as_pydantic_fills_them() -> None:
    for kind, value in PLAIN:
        assert repr(accepted.filled(kind, value)) == repr(judged.filled(kind, value)[0])


@settings(max_examples=300, deadline=None)
@given(st.data())
def test_no_change_of_values_is_accepted_that_pydantic_refuses(data: st.DataObject) -> None:
    kind, value = data.draw(st.sampled_from(PLAIN[:-1]))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.sampled_from(places(value)))
        how = data.draw(st.sampled_from(["replace", "remove", "add"]))
        value = changed(value, place, data.draw(VALUES), how)
    filled = accepted.filled(kind, value)
    assert filled is None or repr(filled) == repr(judged.filled(kind, value)[0])


@pytest.mark.parametrize("value", [float("inf"), float("nan"), 1e400, True, "1", 10**400])
def test_a_number_that_is_none_is_left_to_pydantic(value: object) -> None:
    assert accepted.filled(CameraSettings, {"port": value}) is None
