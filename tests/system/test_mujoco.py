"""The daemon in the MuJoCo world: the whole chain, judged by MuJoCo's truth."""

from functools import cache
from typing import Any

import pytest

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge

pytestmark = pytest.mark.row

pytest.importorskip("mujoco", reason="the extra 'mujoco' is not installed")

SEEDS = (1, 11)


@cache
def result(seed: int) -> dict[str, Any]:
    return judge(lockstep.run(setup.make("wheel", world="mujoco"), seed))


@pytest.mark.parametrize("seed", SEEDS)
def test_the_wheel_is_assembled(seed: int) -> None:
    assert result(seed)["outcome"] == "assembled", result(seed)["reason"]


@pytest.mark.parametrize("seed", SEEDS)
def test_the_wheel_meets_the_bolts_within_their_chamfer(seed: int) -> None:
    assert result(seed)["total_error"]["impact"]["max_mm"] < 1.0


@pytest.mark.parametrize("seed", SEEDS)
def test_no_setpoint_is_beyond_the_limits_of_an_axis(seed: int) -> None:
    found = result(seed)
    assert found["limits"]["violations"] == 0
    assert found["telegrams"]["answered"] == found["telegrams"]["sent"]


def test_a_truth_that_the_station_has_of_its_own_is_refused() -> None:
    with pytest.raises(setup.SetupError, match="sizes of its own"):
        setup.make("wheel", ["scenario.camera.dropout_rate=0.5"], world="mujoco")


def test_the_true_future_is_not_known() -> None:
    made = setup.make("wheel", variant="oracle", world="mujoco")
    with pytest.raises(setup.SetupError, match="oracle"):
        lockstep.Lockstep(made, 0)
