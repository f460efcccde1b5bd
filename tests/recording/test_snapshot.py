"""A state as bytes: a step goes on from it exactly as it would have."""

from functools import cache

import msgpack
import numpy as np
import pytest
from cell import World, parameters
from hypothesis import given
from hypothesis import strategies as st

from linemate.daemon.core.inputs import Inputs, MotionOrder
from linemate.daemon.core.step import step
from linemate.daemon.core.step_state import Outputs, StepState
from linemate.daemon.recording import snapshot
from linemate.daemon.recording.snapshot import SnapshotError
from linemate.daemon.recording.step_codec import decode, differences, encode


@cache
def recorded_steps() -> tuple[tuple[StepState, Inputs, Outputs], ...]:
    """A few seconds of a run up to the approach."""
    world = World(parameters())
    world.run(1.5)
    made = []
    for k in range(250):
        inputs = world.inputs(MotionOrder.TRACK, start=k == 0)
        before = world.state
        made.append((before, inputs, world.take(inputs)))
    return tuple(made)


def test_a_step_goes_on_bit_for_bit_from_a_state_that_was_kept() -> None:
    rows = recorded_steps()
    for begin in range(0, len(rows) - 10, 24):
        state = snapshot.decode(snapshot.encode(rows[begin][0]))
        for _, inputs, outputs in rows[begin : begin + 10]:
            state, made = step(state, inputs, parameters())
            assert differences(decode(encode(1, "track", inputs, outputs)), made) == ()


def test_a_state_comes_back_as_the_same_bytes() -> None:
    data = snapshot.encode(recorded_steps()[-1][0])
    assert snapshot.encode(snapshot.decode(data)) == data
    assert len(data) < 100_000


def test_an_array_keeps_its_bits_its_shape_and_its_order_in_memory() -> None:
    for array in (
        np.array([[0.1, -0.0, np.nan], [np.inf, 5e-324, 1.0]]),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.zeros((0, 4)),
        np.array([True, False]),
        np.arange(3),
    ):
        again = snapshot._rebuilt(msgpack.unpackb(msgpack.packb(snapshot._plain(array))))
        assert again.tobytes(order="A") == array.tobytes(order="A")
        assert again.shape == array.shape
        assert again.dtype == array.dtype
        assert again.flags.f_contiguous == array.flags.f_contiguous
        assert again.flags.writeable


@pytest.mark.parametrize(
    "tree",
    [
        ["o", "service.app:App", {}],
        ["o", "step.os:system", {}],
        ["o", "tracking.tracker:replace", {}],
        ["e", "step:State", "x"],
        ["e", "tracking.task:Phase", "nonsense"],
        ["o", "step:State", {"tracker": None}],
        ["a", "|O", [1], "C", b"\0" * 8],
        ["a", "<f8", [2], "C", b"\0" * 8],
        ["x"],
        [],
        ["o", "tracking.task:Phase", {}],
        1.5,
    ],
)
def test_only_parts_of_a_state_are_made_again(tree: object) -> None:
    with pytest.raises(SnapshotError):
        snapshot.decode(msgpack.packb([snapshot.VERSION, tree]))


def test_another_version_is_refused_by_its_number() -> None:
    with pytest.raises(SnapshotError, match="version 99"):
        snapshot.decode(msgpack.packb([99, None]))


@given(st.binary(max_size=200))
def test_any_bytes_are_a_state_or_its_one_error(data: bytes) -> None:
    with pytest.raises(SnapshotError):
        snapshot.decode(data)


def test_what_has_no_place_in_a_state_is_refused() -> None:
    with pytest.raises(SnapshotError, match="complex"):
        snapshot.encode(1j)  # type: ignore[arg-type]


def test_a_renamed_field_keeps_its_name_in_a_recording() -> None:
    for name, renamed in snapshot._FIELDS.items():
        fields = snapshot._kind(name).__struct_fields__
        assert set(renamed.values()) <= set(fields)
        assert not set(renamed) & (set(fields) - set(renamed.values()))
    state = recorded_steps()[-1][0]
    _, tree = msgpack.unpackb(snapshot.encode(state))
    stored = tree[2]["tracker"][2]["belief"][2]
    assert "pushes" in stored
    assert "impulses" not in stored
    assert snapshot.encode(snapshot.decode(snapshot.encode(state))) == snapshot.encode(state)


def test_a_field_that_a_state_has_no_more_is_left_out() -> None:
    state = recorded_steps()[-1][0]
    version, tree = msgpack.unpackb(snapshot.encode(state))
    _, _, leads = tree[2]["tracker"][2]["monitor"][2]["leads"]
    leads[2]["depth"] = 0.001
    again = snapshot.decode(msgpack.packb([version, tree]))
    assert again.tracker.monitor.leads[1].errors == state.tracker.monitor.leads[1].errors
    leads[2]["width"] = 0.001
    with pytest.raises(SnapshotError):
        snapshot.decode(msgpack.packb([version, tree]))
