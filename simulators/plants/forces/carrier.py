"""Car in its carrier: modes excited by the conveyor's acceleration and by the contact force.

While the clamp holds the tool, the tool's mass moves with the hub and the mount pulls at both:
    (M + P' Mt P) q'' + (C + P' Ct P) q' + (K + P' Kt P) q = -(M g + P' Mt y) a - P'(Kt e + Ct e')
q: coordinates; P: hub per coordinate; Mt, Ct, Kt: tool and mount in c; y: travel; a: the
conveyor's acceleration; e: deflection of the mount that is left when no mode moves.

Invariants:
    The state depends on the past; a step is exact for an input that is linear within it.
    Closing clamp and catch exchange momentum; nothing else makes the velocity jump.
    The tilt of the tool against the car is the one at the catch (it changes by some mrad).
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from linemate.simulators.plants import rotation
from linemate.simulators.plants.body import C_IN_BASE
from linemate.simulators.plants.forces import linear
from linemate.simulators.plants.forces.linear import Array
from linemate.simulators.plants.forces.switches import CarrierMode
from linemate.simulators.plants.rotation import Pose

UNMOVED_KG = 1e12
"""Mass that stands for a mode that no force moves."""

_KEPT = 64
"""Steps of other lengths that are kept: instants of the sensors between grid points."""

_BLOCK = 256
"""Steps for which the conveyor's speed is computed at once: it depends on time alone."""

_C_IN_BASE = np.array(C_IN_BASE).reshape(3, 3)
_TRAVEL = np.array((0.0, 1.0, 0.0, 0.0, 0.0, 0.0))


@dataclass(frozen=True, slots=True)
class Mount:
    """Tool and mount as they act on the car: matrices in c, (6, 6); translation first.

    Attributes:
        axes: axes of the rigid tcp in c, for vectors of six, (6, 6).
    """

    mass: Array
    damping: Array
    stiffness: Array
    axes: Array

    @classmethod
    def at(cls, rigid: Pose, mass: Array, damping: Array, stiffness: Array) -> "Mount":
        """Turn the values along and about the axes of the rigid tcp, each (6,), into c."""
        turned = _C_IN_BASE.T @ np.array(rigid[1]).reshape(3, 3)
        axes = linear.for_both(turned)
        in_c = [axes @ np.diag(values) @ axes.T for values in (mass, damping, stiffness)]
        return cls(in_c[0], in_c[1], in_c[2], axes)


class CarrierPlant:
    """Coordinates of the modes and their speeds.

    Attributes:
        energy: work that the mount has done on car and held tool, relative to the conveyor [J].
        expects: the last step was made with a force of the step before.
    """

    def __init__(
        self,
        modes: Sequence[CarrierMode],
        speeds: Callable[[Array], Array],
        start_s: float,
        step_s: float,
    ) -> None:
        """Start at rest.

        Args:
            speeds: of the conveyor at ascending scenario times, (n,) [m/s].
        """
        self._shape = np.array([(*mode.direction, *mode.turn) for mode in modes]).T
        omega = np.array([2.0 * np.pi * mode.frequency_hz for mode in modes])
        mass = np.array([mode.mass or UNMOVED_KG for mode in modes])
        zeta = np.array([mode.damping for mode in modes])
        self._mass = np.diag(mass)
        self._damping = np.diag(2.0 * zeta * omega * mass)
        self._stiffness = np.diag(omega**2 * mass)
        self._drive = mass * np.array([mode.drive for mode in modes])
        self._speeds, self._start, self._h = speeds, start_s, step_s
        # Of the conveyor in each step of the grid: speed at its begin, mean acceleration.
        self._begins: list[float] = []
        self._means: list[float] = []
        # Of the conveyor at instants within steps that are to come, by the instant.
        self._foreseen: dict[float, float] = {}
        self._count = len(modes)
        self.yields = any(mode.mass for mode in modes)
        self._mount: Mount | None = None
        self._pull = np.zeros(6)
        self._expected, self.expects = np.zeros(len(modes)), False
        self._steps: dict[float, linear.Step] = {}
        self._free_step = self._new_step(step_s)
        self._state = np.zeros(2 * self._count)
        self._history = [self._state]
        self._ahead: list[Array] = []
        self.energy = 0.0

    @property
    def coordinates(self) -> Array:
        """Of the modes, now [m]."""
        return self._state[: self._count]

    @property
    def speeds(self) -> Array:
        """Of the modes, now [m/s]."""
        return self._state[self._count :]

    @property
    def sway(self) -> Array:
        """Displacement [m] and rotation [rad] of the hub by the modes in c, now, (6,)."""
        return self._shape @ self.coordinates

    @property
    def held(self) -> bool:
        """The mount pulls at the car."""
        return self._mount is not None

    def advance(self, pull: Array | None = None) -> None:
        """Go on to the next grid point.

        Args:
            pull: while held, the deflection that the mount would have there if the modes stood
                still from now on, along and about the axes of the rigid tcp, (6,).
        """
        before = self._state
        self._state = self._after(self._h, self._mean(), pull)
        self._history.append(self._state)
        self._ahead.clear()
        if self._mount is not None and pull is not None:
            self._work(self._mount, before, pull)

    def peek(self, t: float, pull: Array | None = None) -> Array:
        """Displacement and rotation of the hub in c within the step that comes next, (6,).

        Args:
            pull: as for ``advance``, at t.
        """
        now = self._now()
        dt = max(t - now, 0.0)
        if dt <= 0.0:
            return self.sway
        self._mean()
        speed = self._foreseen.pop(now + dt, None)
        if speed is None:
            speed = float(self._speeds(np.array((now + dt,)))[0])
        rise = speed - self._begins[self._index]
        return np.asarray(self._shape @ self._after(dt, rise / dt, pull)[: self._count])

    def foresee(self, times: Array) -> None:
        """Compute the conveyor's speed at instants of ``peek`` to come, ascending, all at once.

        It depends on time alone, and one instant costs as much as a hundred.
        """
        begins = self._start + self._h * np.floor((times - self._start) / self._h + 1e-9)
        # As ``peek`` does, to the last bit: another instant is computed when it is asked for.
        times = begins + np.maximum(times - begins, 0.0)
        self._foreseen = dict(zip(times.tolist(), self._speeds(times).tolist(), strict=True))

    def at(self, t: float) -> Array:
        """Displacement and rotation of the hub in c at any time, (6,).

        The past is as it was. The future is without a force of contact, which no one knows.
        """
        cell = max((t - self._start) / self._h, 0.0)
        index = int(cell + 1e-9)
        while index + 1 >= len(self._history) + len(self._ahead):
            self._forecast()
        first, second = self._known(index), self._known(index + 1)
        x = _between(first, second, self._h, cell - index)
        return np.asarray(self._shape @ x)

    def seize(self, mount: Mount, relative: Array) -> None:
        """Let the clamp hold the tool: tool and car share their momentum.

        Args:
            relative: velocity in c that the tool loses, as far as no mode moves, (6,).
        """
        self._mount = mount
        self._expected, self.expects = np.zeros(self._count), False
        self._new_steps()
        self.push(mount, relative - self._shape @ self.speeds)

    def push(self, mount: Mount, velocity: Array) -> None:
        """Take over the momentum of the held tool that loses this velocity in c, (6,)."""
        inertia = self._mass + self._shape.T @ mount.mass @ self._shape
        gained = np.linalg.solve(inertia, self._shape.T @ mount.mass @ velocity)
        self._state = self._state + np.concatenate((np.zeros(self._count), gained))
        self._history[-1] = self._state
        self._ahead.clear()

    def inverse_mass(self, axes: Array) -> Array:
        """How the hub gives way to an impulse, in axes given in c (6, 6): velocity of impulse."""
        shape = axes.T @ self._shape
        return np.asarray(shape @ np.linalg.solve(self._mass, shape.T))

    def strike(self, impulse: Array, impulse_time: Array) -> None:
        """Correct the step that has ended by the impulse that the hub got in it, in c, (6,).

        The step was made with the mean force of the one before, which is taken off.

        Args:
            impulse_time: integral of the impulse over the step [Ns s].
        """
        h = self._h
        given = self._shape.T @ np.column_stack((impulse_time, impulse))
        more = given - np.outer(self._expected, (0.5 * h * h, h))
        self._expected = given[:, 1] / h
        self.expects = bool(self._expected.any())
        gained = np.linalg.solve(self._mass, more)
        self._state = self._state + gained.T.ravel()
        self._history[-1] = self._state
        self._ahead.clear()

    def let_go(self) -> None:
        """Free the car of tool and mount; it keeps its speed."""
        self._mount = None
        self._pull = np.zeros(6)
        self._new_steps()

    def begin_pull(self, deflection: Array) -> None:
        """Set the deflection of the mount at the grid point reached, in axes of the tcp, (6,)."""
        if self._mount is not None:
            self._pull = self._mount.axes @ deflection

    def mechanical_energy(self) -> float:
        """Energy in the modes, without tool and mount [J]."""
        q, v = self.coordinates, self.speeds
        return float(0.5 * (v @ self._mass @ v + q @ self._stiffness @ q))

    @property
    def _index(self) -> int:
        return len(self._history) - 1

    def _now(self) -> float:
        return self._start + self._index * self._h

    def _mean(self) -> float:
        """Mean acceleration of the conveyor in the step that comes next."""
        index, known = self._index, len(self._means)
        if index >= known:
            times = self._start + self._h * np.arange(known, known + _BLOCK, dtype=np.float64)
            begins = self._speeds(times)
            self._begins += begins.tolist()
            self._means += ((self._speeds(times + self._h) - begins) / self._h).tolist()
        return self._means[index]

    def _after(self, dt: float, mean: float, pull: Array | None) -> Array:
        """State after dt in which the conveyor has this mean acceleration."""
        step = self._steps.get(round(dt, 9)) or self._new_step(dt)
        mount = self._mount
        if mount is None or pull is None:
            force = self._expected - self._drive * mean
            return np.asarray(step.state @ self._state + step.steady @ force)
        first, last = self._left(mount, pull)
        force = -(self._drive + self._shape.T @ mount.mass @ _TRAVEL) * mean
        force = force - self._shape.T @ mount.damping @ (last - first) / dt
        start = force - self._shape.T @ mount.stiffness @ first
        end = force - self._shape.T @ mount.stiffness @ last
        return np.asarray(step.state @ self._state + step.start @ start + step.end @ end)

    def _left(self, mount: Mount, pull: Array) -> tuple[Array, Array]:
        """Deflection in c without the modes' part, now and where ``pull`` is."""
        moved = self._shape @ self.coordinates
        return self._pull - moved, mount.axes @ pull - moved

    def _work(self, mount: Mount, before: Array, pull: Array) -> None:
        n = self._count
        path = self._shape @ (self._state[:n] - before[:n])
        reached = mount.axes @ pull + path
        mean = 0.5 * mount.stiffness @ (self._pull + reached)
        mean = mean + mount.damping @ (reached - self._pull) / self._h
        self.energy -= float(mean @ path)

    def _new_steps(self) -> None:
        self._steps.clear()
        if self._mount is None:
            self._steps[round(self._h, 9)] = self._free_step

    def _new_step(self, dt: float) -> linear.Step:
        mass, damping, stiffness = self._mass, self._damping, self._stiffness
        if self._mount is not None:
            mount, shape = self._mount, self._shape
            mass = mass + shape.T @ mount.mass @ shape
            damping = damping + shape.T @ mount.damping @ shape
            stiffness = stiffness + shape.T @ mount.stiffness @ shape
        if len(self._steps) >= _KEPT:
            self._steps.clear()
        return self._steps.setdefault(round(dt, 9), linear.step(mass, damping, stiffness, dt))

    def _known(self, index: int) -> Array:
        past = len(self._history)
        return self._history[index] if index < past else self._ahead[index - past]

    def _forecast(self) -> None:
        index = len(self._history) + len(self._ahead)
        t = self._start + index * self._h
        before, now = self._speeds(np.array((t - self._h, t))).tolist()
        mean = (now - before) / self._h
        step, last = self._free_step, self._known(index - 1)
        self._ahead.append(step.state @ last - step.steady @ (self._drive * mean))


def swayed(hub: Pose, sway: Array) -> Pose:
    """The hub in base, moved by the modes.

    Args:
        sway: displacement and rotation in c, (6,).
    """
    x, y, z, a, b, c = sway.tolist()
    px, py, pz = hub[0]
    in_c = rotation.compose(rotation.transpose(C_IN_BASE), hub[1])
    turned = rotation.compose(C_IN_BASE, rotation.compose(rotation.exp((a, b, c)), in_c))
    return (px + z, py + y, pz - x), turned


def _between(first: Array, second: Array, step: float, share: float) -> Array:
    """Coordinates between two grid points, from coordinates and speeds at both."""
    n = len(first) // 2
    s, r = share, 1.0 - share
    return np.asarray(
        (1.0 + 2.0 * s) * r * r * first[:n]
        + s * r * r * step * first[n:]
        + s * s * (3.0 - 2.0 * s) * second[:n]
        - s * s * r * step * second[n:]
    )
