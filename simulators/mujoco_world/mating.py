"""Course of the assembly: touch, screws, release and collision, judged by MuJoCo's state.

Invariants:
    Bits from the controller: 0 fix the screws, 1 release the wheel.
    Bits to the controller: 0 screws fixed, 1 wheel released.
    The first collision is kept with its time and reason.
"""

import math
from dataclasses import dataclass
from typing import Literal

from linemate.simulators.mujoco_world.frame_poses import Vec
from linemate.simulators.mujoco_world.mujoco_cell import Six, Tool, known

Phase = Literal["free", "clamped", "released"]

FIX_SCREWS, RELEASE_WHEEL = 1, 2
SCREWS_FIXED, WHEEL_RELEASED = 1, 2

TOUCH_N = 1.0
PULLED_IN_S = 0.05
SEATED_M = 1.5e-3
FREE_M = 0.005
BOLT_TIP_M = 0.015
HUB_RADIUS_M = 0.3
CAUGHT_LATERAL_M = 0.006
CLEAR_M = 0.010
DRAG_M = 0.020
PUSH_M = 0.008


@dataclass(frozen=True, slots=True)
class FirstTouch:
    """First touch of wheel and hub.

    Attributes:
        position: tcp in the hub's frame [m].
        rotation: the same as a rotation vector [rad].
        speed: closing speed along the hub's z [m/s].
    """

    time_s: float
    position: Vec
    rotation: Vec
    speed: float


@dataclass(frozen=True, slots=True)
class MatingCollision:
    """What went wrong, when, and with what figures."""

    time_s: float
    reason: str


@dataclass(frozen=True, slots=True)
class MatingPoses:
    """Wheel, tool and hub at one instant.

    Attributes:
        tool: tcp in the hub's frame: position [m], then rotation vector [rad].
        wheel: position of the wheel in the hub's frame [m].
        tool_in_wheel: position of the tcp in the wheel's frame [m].
        touch_n: force that the hub puts on the wheel, by contact and screws together [N].
        mount_n: force on the mount beyond the weight it was zeroed with [N].
        mount_nm: torque on it, likewise [Nm].
    """

    tool: Six
    wheel: Vec
    tool_in_wheel: Vec
    touch_n: float
    mount_n: float
    mount_nm: float


class BoltMating:
    """State of the assembly."""

    def __init__(self, tool: Tool) -> None:
        self._tool = tool
        self.phase: Phase = "free"
        self.impact: FirstTouch | None = None
        self.collision: MatingCollision | None = None
        self.fixed_s: float | None = None
        self.released_s: float | None = None
        self._orders = 0
        self._screwing_s: float | None = None
        self._releasing_s: float | None = None
        self._pulled_in_s: float | None = None
        self._before_m = -math.inf
        self._is_clear = False

    def order(self, bits: int) -> None:
        """Take the controller's bits."""
        self._orders = bits

    @property
    def signals(self) -> int:
        """The tool's bits to the controller."""
        fixed = SCREWS_FIXED if self.fixed_s is not None else 0
        return fixed | (WHEEL_RELEASED if self.released_s is not None else 0)

    @property
    def are_screws_in(self) -> bool:
        """Whether the screws hold the wheel."""
        return self._pulled_in_s is not None

    @property
    def is_gripped(self) -> bool:
        """Whether the gripper holds the wheel."""
        return self.released_s is None

    def advance(self, t: float, dt: float, now: MatingPoses) -> None:
        """Judge one time step that ends at t."""
        depth = now.wheel[2]
        if self.phase == "free" and now.touch_n > TOUCH_N:
            self.phase = "clamped"
            if self.impact is None:
                self.impact = FirstTouch(
                    t, now.tool[:3], now.tool[3:], (depth - self._before_m) / dt
                )
        elif self.phase == "clamped" and not self.are_screws_in and depth < -(BOLT_TIP_M + FREE_M):
            self.phase = "free"
        self._before_m = depth
        if self.phase != "released":
            self._watch(t, now)
        else:
            self._watch_clearing(t, now)
        self._turn_screws(t, now)
        self._release(t)

    def _watch(self, t: float, now: MatingPoses) -> None:
        """Note a collision of the wheel in the gripper."""
        x, y, z = now.wheel
        lateral = math.hypot(x, y)
        if now.mount_n > self._tool.mount_limit:
            self._collide(t, f"mount overloaded: {now.mount_n:.0f} N")
        elif now.mount_nm > self._tool.mount_torque_limit:
            self._collide(t, f"mount overloaded: {now.mount_nm:.0f} Nm")
        elif now.touch_n > self._tool.contact_limit:
            self._collide(t, f"wheel and hub pressed with {now.touch_n:.0f} N")
        elif z > -BOLT_TIP_M and CAUGHT_LATERAL_M < lateral < HUB_RADIUS_M:
            self._collide(t, f"missed the bolts: {1e3 * lateral:.1f} mm")

    def _watch_clearing(self, t: float, now: MatingPoses) -> None:
        """Note a collision of the empty gripper that has to leave the wheel."""
        if self._is_clear:
            return
        x, y, z = now.tool_in_wheel
        lateral = math.hypot(x, y)
        if lateral > DRAG_M:
            self._collide(t, f"gripper caught in the wheel by {1e3 * lateral:.1f} mm")
        elif z > PUSH_M:
            self._collide(t, f"gripper pushed into the wheel by {1e3 * z:.1f} mm")
        self._is_clear = z < -CLEAR_M

    def _turn_screws(self, t: float, now: MatingPoses) -> None:
        if self._pulled_in_s is not None:
            if self.fixed_s is None and t - self._pulled_in_s >= PULLED_IN_S:
                self.fixed_s = t
            return
        x, y, z = now.wheel
        is_seated = abs(z) < SEATED_M and math.hypot(x, y) < SEATED_M
        if not (self._orders & FIX_SCREWS and is_seated):
            self._screwing_s = None
        elif self._screwing_s is None:
            self._screwing_s = t
        elif t - self._screwing_s >= self._tool.screws_s:
            self._pulled_in_s = t

    def _release(self, t: float) -> None:
        if self.released_s is not None:
            return
        if not self._orders & RELEASE_WHEEL:
            self._releasing_s = None
        elif self._releasing_s is None:
            self._releasing_s = t
        elif t - self._releasing_s >= known(self._tool.release_s):
            self.released_s, self.phase = t, "released"
            if not self.are_screws_in:
                self._collide(t, "wheel dropped: released before the screws were fixed")

    def _collide(self, t: float, reason: str) -> None:
        if self.collision is None:
            self.collision = MatingCollision(t, reason)
