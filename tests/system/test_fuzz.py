"""A short share of the fuzzing of every wire; ``make fuzz`` has the whole."""

import contextlib

import fuzz
import pytest

from linemate.protocol.errors import ProtocolError


@pytest.mark.parametrize("name", sorted(fuzz.wires()))
def test_any_bytes_on_any_wire_are_a_message_or_its_own_error(name: str) -> None:
    # A stream takes anything and gives what is good in it; others refuse most.
    assert fuzz.run(name, 2000) < 2000 or name in {"bota", "ft300"}
    assert fuzz.wires()[name].examples


@pytest.mark.parametrize("name", sorted(fuzz.wires()))
def test_what_coverage_found_is_a_message_or_the_wires_own_error(name: str) -> None:
    parse = fuzz.wires()[name].parse
    inputs = fuzz.corpus()[name]
    assert inputs
    for data in inputs:
        with contextlib.suppress(ProtocolError):
            parse(data)


def test_whole_messages_are_taken() -> None:
    for wire in fuzz.wires().values():
        wire.parse(wire.examples[0])
