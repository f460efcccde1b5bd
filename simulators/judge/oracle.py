"""True future of the object for the variant ``oracle``.

Invariants:
    The plants' own motion, evaluated ahead of time.
    The world is asked only for the step of the screws after their order.
    Poses are in the nominal frame c.
"""

import math
from dataclasses import dataclass, field

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.horizon import Array
from linemate.simulators.judge.rows import EPOCH_NS
from linemate.simulators.plants.body import BodyPlant
from linemate.simulators.plants.conveyor_plant import ConveyorPlant
from linemate.simulators.plants.world import World

AHEAD_S = 3.0
"""How far behind the end of the run the table reaches; no horizon is longer."""

_OFF_GRID = 1e-6
_SAME = 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class _HubTable:
    """The hub on the grid of steps, in c: positions (n, 3) [m], vectors (n, 3) [rad].

    ``turn`` (3, 3) is the step of the screws that the vectors hold.
    """

    positions: Array
    vectors: Array
    turn: Array = field(default_factory=lambda: np.eye(3))


class Oracle:
    """True future of the hub for the tracker; called as a ``tracker.Foresight``."""

    def __init__(self, world: World, nominal: Array, cycle_s: float) -> None:
        """Tabulate the hub over the whole run.

        Args:
            world: of the run, at its beginning.
            nominal: (3, 3) axes of the frame c in base.
            cycle_s: grid of the steps [s].
        """
        scenario = world.scenario
        self._world, self._nominal, self._cycle_s = world, nominal, cycle_s
        self._begin_s = -scenario.lead_in_s
        span = scenario.lead_in_s + scenario.duration_s + AHEAD_S
        steps = np.arange(math.ceil(span / cycle_s) + 1, dtype=np.float64)
        times = self._begin_s + cycle_s * steps
        conveyor = ConveyorPlant(scenario.conveyor, scenario.seed, self._begin_s)
        hubs = BodyPlant(scenario.body).hubs(conveyor.positions(times), times)
        places = np.array([hub[0] for hub in hubs])
        self._bare = np.array([hub[1] for hub in hubs]).reshape(-1, 3, 3)
        self._table = _HubTable(places @ nominal, rotations.log_many(nominal.T @ self._bare))

    def __call__(self, stamp_ns: int, ahead: Array) -> tuple[Array, Array]:
        """Return the hub's positions (m, 3) [m] and rotation vectors (m, 3) [rad] in c.

        Args:
            ahead: times from it (m,) [s].
        """
        now_s = self._begin_s + (stamp_ns - EPOCH_NS) * 1e-9
        cells = (now_s - self._begin_s + ahead) / self._cycle_s
        index = np.rint(cells).astype(np.intp)
        if np.abs(cells - index).max() > _OFF_GRID or not self._holds(
            int(index[0]), int(index[-1])
        ):
            return self._asked(now_s + ahead)
        return self._table.positions[index], self._table.vectors[index]

    def _holds(self, first: int, last: int) -> bool:
        """Return whether the screws turn the hub alike from ``first`` to ``last``; tabulate it."""
        if first < 0 or last >= len(self._bare):
            return False
        turn = self._turn(first)
        if np.abs(self._turn(last) - turn).max() > _SAME:
            return False
        if np.abs(turn - self._table.turn).max() > _SAME:
            vectors = rotations.log_many(self._nominal.T @ self._bare @ turn)
            self._table = _HubTable(self._table.positions, vectors, turn)
        return True

    def _turn(self, index: int) -> Array:
        """Return by what the screws turn the hub (3, 3) at one step of the grid."""
        true = self._world.hub_pose(self._begin_s + index * self._cycle_s)
        return np.asarray(self._bare[index].T @ true[:3, :3])

    def _asked(self, times: Array) -> tuple[Array, Array]:
        """Return what the world says of each instant (m,) [s]."""
        hubs = np.array([self._world.hub_pose(t) for t in times.tolist()])
        turned = self._nominal.T @ hubs[:, :3, :3]
        return hubs[:, :3, 3] @ self._nominal, rotations.log_many(turned)
