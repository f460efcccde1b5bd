"""The oracle: what it says is what the world will do, to the last digit."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import compute_errors, judge
from linemate.simulators.judge.oracle import Oracle
from linemate.simulators.judge.rows import CLAMPED, EPOCH_NS
from linemate.simulators.plants.body import C_IN_BASE
from linemate.simulators.plants.scenario import Scenario
from linemate.simulators.plants.scenario_draw import sample
from linemate.simulators.plants.world import World

NOMINAL = np.array(C_IN_BASE).reshape(3, 3)
T0 = 0.012


def world() -> World:
    return World(sample(7, replace(Scenario(), lead_in_s=1.0, duration_s=6.0)))


def expected(world: World, times: Array) -> tuple[Array, Array]:
    hubs = np.array([world.hub_pose(float(t)) for t in times])
    vectors = [rotations.log(NOMINAL.T @ hub[:3, :3]) for hub in hubs]
    return hubs[:, :3, 3] @ NOMINAL, np.array(vectors)


@pytest.mark.parametrize("offset_ns", [0, 1, 5_000_000], ids=["grid", "rounding", "between"])
def test_the_future_is_the_worlds_own(offset_ns: int) -> None:
    plant = world()
    oracle = Oracle(plant, NOMINAL, T0)
    for step in (0, 100, 497):
        stamp_ns = EPOCH_NS + step * 12_000_000 + offset_ns
        ahead = np.arange(42) * T0
        positions, vectors = oracle(stamp_ns, ahead)
        true = expected(plant, -1.0 + step * T0 + offset_ns * 1e-9 + ahead)
        assert np.abs(positions - true[0]).max() < 1e-9
        assert np.abs(vectors - true[1]).max() < 1e-9


def test_a_future_behind_the_table_is_asked_from_the_world() -> None:
    plant = world()
    ahead = np.arange(3) * T0 + 20.0
    positions, _ = Oracle(plant, NOMINAL, T0)(EPOCH_NS, ahead)
    assert np.abs(positions - expected(plant, ahead - 1.0)[0]).max() < 1e-9


def test_with_the_future_known_no_error_of_prediction_is_left_even_as_the_screws_step() -> None:
    evidence = lockstep.run(setup.make("wheel", variant="oracle"), 0)
    rows = evidence.rows
    distance, angle = compute_errors(rows)["prediction"]
    known = np.isfinite(distance)
    assert known[rows.contact == CLAMPED].all()
    assert distance[known].max() < 1e-8
    assert angle[known].max() < 1e-6
    result = judge(evidence)
    assert result["variant"] == "oracle"
    assert result["assembled"]
    # The class is still the classifier's: the oracle replaces the prediction only.
    assert all(entry["confirmed_s"] > 0.0 for entry in result["detection"])
