"""Strict YAML: any bytes give a value or complaints with their places."""

from dataclasses import dataclass, field
from enum import StrEnum
from typing import Annotated, Any

import pytest
import yaml
from annotated_types import Ge, Len
from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.config.documents import Complaint, FileError, fill, read, schema, spelled


class Colour(StrEnum):
    RED = "red"
    BLUE = "blue"


@dataclass(frozen=True, slots=True)
class Part:
    length: Annotated[float, Ge(0.0)]
    name: str = "part"


@dataclass(frozen=True, slots=True)
class Whole:
    parts: Annotated[tuple[Part, ...], Len(1, 3)]
    count: int = 1
    on: bool = False
    colour: Colour = Colour.RED
    free: dict[str, Any] = field(default_factory=dict)
    maybe: Part | None = None


def load(text: str | bytes) -> Whole:
    data = text.encode() if isinstance(text, str) else text
    return fill(read(data, "f.yaml"), Whole)


def check_lines(error: FileError) -> None:
    assert error.lines
    assert all(line.startswith("f.yaml:") for line in error.lines)


def errors(text: str | bytes) -> list[str]:
    with pytest.raises(FileError) as caught:
        load(text)
    return list(caught.value.lines)


def test_a_good_file_fills_its_dataclass() -> None:
    whole = load("parts: [{length: 1e-3, name: '010'}, {length: 2}]\ncolour: blue\nfree: {a: 1}")
    assert whole == Whole((Part(0.001, "010"), Part(2.0)), colour=Colour.BLUE, free={"a": 1})


def test_every_error_is_reported_at_once_and_in_the_order_of_the_file() -> None:
    text = "parts:\n- {length: -1}\n- {lenght: 1}\ncount: 1.5\non: 1\ncolour: green\nmore: 2\n"
    assert errors(text) == [
        "f.yaml:2:12: parts[0].length: should be greater than or equal to 0, not -1",
        "f.yaml:3:3: parts[1].length: missing",
        "f.yaml:3:4: parts[1].lenght: unknown key; near is length",
        "f.yaml:4:8: count: should be a valid integer, not 1.5",
        "f.yaml:5:5: on: should be a valid boolean, not 1",
        "f.yaml:6:9: colour: should be 'red' or 'blue', not \"green\"",
        "f.yaml:7:1: more: unknown key",
    ]


def test_a_key_given_twice_is_an_error_at_its_second_place() -> None:
    assert errors("parts: [{length: 1}]\ncount: 1\ncount: 2\n") == [
        "f.yaml:3:1: count: given twice, first in line 2"
    ]


@pytest.mark.parametrize(
    "plain", ["no", "Yes", "off", "y", "010", "0o17", "0b1", "12:30", "1_000", "2026-01-31", "-007"]
)
def test_what_yaml_1_1_and_1_2_read_differently_is_refused(plain: str) -> None:
    (line,) = errors(f"parts: [{{length: 1, name: {plain}}}]")
    assert line.startswith("f.yaml:1:27: parts[0].name: ")
    assert f"{plain} means different things" in line
    assert load(f"parts: [{{length: 1, name: '{plain}'}}]").parts[0].name == plain


@pytest.mark.parametrize("plain", [".nan", ".inf", "-.inf", "nan", "Infinity", "1e999"])
def test_what_is_not_finite_is_refused(plain: str) -> None:
    assert errors(f"parts: [{{length: {plain}}}]") == [
        f"f.yaml:1:18: parts[0].length: should be a finite number, not {plain}"
    ]


@pytest.mark.parametrize(
    ("plain", "number"),
    [
        ("1e-3", 1e-3),
        ("1E3", 1e3),
        (".5", 0.5),
        ("2.", 2.0),
        ("+1.5e+2", 150.0),
        ("0x10", 16.0),
        ("0", 0.0),
        ("0.05", 0.05),
    ],
)
def test_numbers_are_read_as_people_write_them(plain: str, number: float) -> None:
    assert load(f"parts: [{{length: {plain}}}]").parts[0].length == number


def test_bytes_that_are_no_utf_8_are_reported_with_their_place() -> None:
    assert errors(b"parts:\n- {length: \xff}") == ["f.yaml:2:12: (file): not UTF-8: byte 0xff"]


@pytest.mark.parametrize(
    ("text", "place", "what"),
    [
        ("a: [1, 2", "1:9", "not YAML"),
        ("a: b: c", "1:5", "not YAML"),
        ("a: 1\n--- \nb: 1", "2:1", "not YAML"),
        ("\x01", "1:1", "not YAML"),
        ('a: "\\UFFFFFFFF"', "1:1", "not YAML"),
        ("[" * 1000, "1:1", "nested too deep"),
        ("a: *b", "1:4", "not YAML"),
        ("&a [*a]", "1:1", "levels"),
        ("x" * 300_000, "1:1", "longer than"),
        ("- 1", "1:1", "should be a mapping"),
        ("a: !!python/object:os.system 1", "1:4", "tags are not understood"),
        ("? [1, 2]\n: 3", "1:1", "a key should be a text"),
        ('colour: "\\uD800"', "1:9", "half of a surrogate pair"),
        ('{"\\uDC00": 1}', "1:2", "half of a surrogate pair"),
    ],
)
def test_what_is_no_document_is_reported_and_never_raises_anything_else(
    text: str, place: str, what: str
) -> None:
    found = [line for line in errors(text) if line.startswith(f"f.yaml:{place}: ")]
    assert any(what in line for line in found)


def test_a_small_file_cannot_grow_large() -> None:
    bomb = "a: &a [1, 1, 1, 1, 1, 1, 1, 1]\n" + "".join(
        f"{b}: &{b} [*{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}, *{a}]\n"
        for a, b in zip("abcdefgh", "bcdefghi", strict=True)
    )
    (line,) = errors(bomb)
    assert "more than" in line


def test_a_check_between_values_is_reported_with_the_others() -> None:
    def check(value: Any) -> list[Complaint]:
        return [Complaint(("count",), "should fit the parts"), Complaint(("parts", 0), "odd")]

    with pytest.raises(FileError) as caught:
        fill(read(b"parts:\n  - {length: x}\ncount: 7", "f"), Whole, check)
    assert [line.split(": ", 1)[1] for line in caught.value.lines] == [
        "parts[0]: odd",
        'parts[0].length: should be a valid number, not "x"',
        "count: should fit the parts",
    ]


def test_a_list_of_wrong_length_is_reported_with_its_items() -> None:
    assert errors("parts: []") == ["f.yaml:1:8: parts: should have at least 1 items, not 0"]
    assert errors("parts: [{length: 1}, {length: 1}, {length: 1}, {length: 1}]") == [
        "f.yaml:1:8: parts: should have at most 3 items, not 4"
    ]
    assert errors("parts: [{length: -1}]") == [
        "f.yaml:1:18: parts[0].length: should be greater than or equal to 0, not -1"
    ]


def test_an_empty_file_lacks_what_has_no_default() -> None:
    assert errors("") == ["f.yaml:1:1: parts: missing"]
    assert errors("# nothing\n") == ["f.yaml:1:1: parts: missing"]


def test_the_schema_names_every_field_and_forbids_others() -> None:
    made = schema(Whole, "whole")
    assert set(made["properties"]) == {"parts", "count", "on", "colour", "free", "maybe"}
    assert made["additionalProperties"] is False
    assert made["$defs"]["Part"]["properties"]["length"]["minimum"] == 0.0


def test_paths_are_spelled_as_operators_write_them() -> None:
    assert spelled(("a", 2, "b")) == "a[2].b"
    assert spelled(()) == "(file)"


@given(st.binary(max_size=200))
def test_any_bytes_give_a_value_or_complaints(data: bytes) -> None:
    try:
        load(data)
    except FileError as error:
        check_lines(error)


YAMLISH = st.lists(
    st.sampled_from(
        [
            *"[]{}:,-&*!|>'\"#%@`? \n\t",
            "parts",
            "length",
            "a: ",
            "- ",
            "&a ",
            "*a",
            "0",
            "1e9",
            ".nan",
            "no",
            "!!int ",
            "<<: ",
            "\\U",
            "é",
            "\ud7ff",
        ]
    ),
    max_size=40,
).map("".join)


@given(YAMLISH)
def test_anything_like_yaml_gives_a_value_or_complaints(text: str) -> None:
    try:
        load(text)
    except FileError as error:
        check_lines(error)


TREES = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=6), inner, max_size=3)
    ),
    max_leaves=12,
)


@given(st.dictionaries(st.sampled_from(["parts", "count", "on", "colour", "free", "maybe"]), TREES))
def test_values_of_any_kind_anywhere_give_a_value_or_complaints(tree: dict[str, Any]) -> None:
    try:
        load(yaml.safe_dump(tree, allow_unicode=True))
    except FileError as error:
        check_lines(error)


@given(st.floats(allow_nan=False, allow_infinity=False, min_value=0.0))
def test_a_float_dumped_by_yaml_is_read_back_exactly(number: float) -> None:
    assert load(yaml.safe_dump({"parts": [{"length": number}]})).parts[0].length == number
