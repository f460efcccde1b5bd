"""Values that fill dataclasses, with pydantic as the judge of which are right."""

import json
from dataclasses import asdict
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.config.reading.filling import Place, fill
from linemate.daemon.config.settings import (
    CameraSettings,
    Config,
    DistanceSettings,
    ForceTorqueSettings,
    ProductionSettings,
    RsiSettings,
)
from linemate.daemon.config.task_file import parse

STRICT = ConfigDict(extra="forbid", strict=True, allow_inf_nan=False)
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
MODELS: dict[type[Any], type[BaseModel]] = {
    kind: create_model("File", __config__=STRICT, root=(kind, ...)) for kind, _ in PLAIN
}
VALUES = st.one_of(
    st.none(),
    st.booleans(),
    st.integers(-3, 3) | st.integers(-(10**30), 10**30),
    st.floats(allow_nan=False, allow_infinity=False),
    st.text("abe1. ", max_size=6) | st.sampled_from(["rsi", "egm", "bank", "absolute", "x" * 5000]),
    st.lists(st.integers(0, 2) | st.none() | st.text("a", max_size=1), max_size=8),
    st.dictionaries(st.text("ab", max_size=2), st.integers(0, 2) | st.text("a"), max_size=3),
)


def judged(kind: type[Any], value: Any) -> tuple[Any, set[Place]]:
    """Return what pydantic makes of plain values, and where it finds them wrong."""
    try:
        model: Any = MODELS[kind].model_validate_json(json.dumps({"root": value}))
    except ValidationError as error:
        found = {tuple(one["loc"][1:]): one["type"] for one in error.errors()}
        # It counts the items of a list without the wrong ones.
        short = {at for at, name in found.items() if name in {"too_short", "too_long"}}
        below = {at[: len(place)] for place in short for at in found if at != place}
        return None, found.keys() - (short & below)
    return model.root, set()


def places(value: Any, path: Place = ()) -> list[Place]:
    """Return the path of each value."""
    parts: Any = enumerate(value) if isinstance(value, list) else ()
    parts = value.items() if isinstance(value, dict) else parts
    return [path, *(place for key, part in parts for place in places(part, (*path, key)))]


def changed(value: Any, place: Place, new: Any, how: str) -> Any:
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


def known(place: Place) -> Place:
    """Return a place without what pydantic adds to it: the key itself, and each of four types."""
    is_constant = place[-3:-2] == ("constants",) and place[-1] in {"bool", "int", "float", "str"}
    return place[:-1] if is_constant or place[-1:] == ("[key]",) else place


def test_whole_files_are_filled_as_pydantic_fills_them() -> None:
    for kind, value in PLAIN:
        filled, wrong = fill(kind, value)
        assert (repr(filled), wrong) == (repr(judged(kind, value)[0]), [])


@given(st.data())
def test_any_change_of_values_is_judged_as_pydantic_judges_it(data: st.DataObject) -> None:
    kind, value = data.draw(st.sampled_from(PLAIN[:-1]))
    for _ in range(data.draw(st.integers(1, 3))):
        place = data.draw(st.sampled_from(places(value)))
        how = data.draw(st.sampled_from(["replace", "remove", "add"]))
        value = changed(value, place, data.draw(VALUES), how)
    filled, wrong = fill(kind, value)
    judgement, misplaced = judged(kind, value)
    assert repr(filled) == repr(judgement)
    assert {one.path for one in wrong} == {known(place) for place in misplaced}
