"""Laws of mating: what is caught, what collides, what screws and release take."""

from collections.abc import Callable
from itertools import pairwise

import pytest

from linemate.simulators.plants import rotation
from linemate.simulators.plants.body import C_IN_BASE
from linemate.simulators.plants.contact_plant import (
    FIX_SCREWS,
    RELEASE_WHEEL,
    SCREWS_FIXED,
    WHEEL_RELEASED,
    ContactPlant,
)
from linemate.simulators.plants.effector import EffectorPlant, deflected
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import Contact, Effector

H = 0.004
HUB: Pose = ((2.2, 0.3, 1.1), C_IN_BASE)


class Bench:
    """A hub that stands still and a rigid tool that is put where a test wants it."""

    def __init__(self, contact: Contact | None = None) -> None:
        self.contact = ContactPlant(contact or Contact())
        # Stiff and dead: the elastic tool is where the rigid one is, unless it is held.
        self.effector = EffectorPlant(Effector(frequency_hz=(400.0,) * 6, damping=(1.0,) * 6), H)
        self.t = 0.0
        self.rigid: Pose | None = None

    def put(self, x: float, y: float, z: float, turn: rotation.Vec = (0.0, 0.0, 0.0)) -> None:
        """One substep to a tool pose in the hub's frame (of the turned hub)."""
        self.t += H
        hub = self.contact.turned(HUB, self.t)
        rigid = rotation.multiply(HUB, ((x, y, z), rotation.exp(turn)))
        self.contact.advance(self.t, H, self.effector, self.rigid or rigid, rigid, hub)
        self.rigid = rigid

    def approach(self, x: float = 0.0, y: float = 0.0, turn: rotation.Vec = (0, 0, 0)) -> None:
        """Close in at 0.1 m/s from 20 mm until 1 mm inside."""
        for k in range(54):
            self.put(x, y, -0.0201 + 0.0004 * k, turn)
            if self.contact.phase != "free" or self.contact.collision:
                return

    def stay(self, seconds: float, **pose: float) -> None:
        for _ in range(round(seconds / H)):
            self.put(pose.get("x", 0.0), pose.get("y", 0.0), pose.get("z", 0.0))

    def reason(self) -> str:
        assert self.contact.collision is not None
        return self.contact.collision.reason


def mated() -> Bench:
    bench = Bench()
    bench.approach()
    assert bench.contact.phase == "clamped"
    return bench


def test_within_tolerance_the_tool_clamps_and_the_impact_is_kept() -> None:
    bench = Bench()
    bench.approach(0.003, -0.004, (0.0, 0.01, -0.02))
    impact = bench.contact.impact
    assert bench.contact.phase == "clamped"
    assert impact is not None
    assert impact.position == pytest.approx((0.003, -0.004, 0.0), abs=1e-5)
    assert impact.rotation == pytest.approx((0.0, 0.01, -0.02), abs=1e-5)
    assert impact.speed == pytest.approx(0.1, rel=0.01)
    assert bench.t - H <= impact.time_s <= bench.t


@pytest.mark.parametrize(
    ("x", "y", "turn"),
    [(0.0061, 0.0, (0, 0, 0)), (0.0045, -0.0045, (0, 0, 0)), (0.0, 0.0, (0, 0.031, 0))],
)
def test_out_of_tolerance_is_a_collision(x: float, y: float, turn: rotation.Vec) -> None:
    bench = Bench()
    bench.approach(x, y, turn)
    assert bench.reason().startswith("missed the hub")
    assert bench.contact.phase == "free"
    assert bench.contact.impact is not None


def test_entering_from_the_side_is_a_collision() -> None:
    bench = Bench()
    for x in (0.6, 0.55, 0.51, 0.49):
        assert bench.contact.collision is None
        bench.put(x, 0.0, 0.05)
    assert bench.reason().startswith("hit the hub from the side")


def test_passing_the_plane_far_off_the_hub_is_none() -> None:
    bench = Bench()
    for k in range(20):
        bench.put(0.7, 0.0, -0.05 + 0.01 * k)
    assert bench.contact.collision is None


def test_the_clamp_closes_without_a_jump_and_then_is_on_the_hub() -> None:
    bench = Bench()
    bench.approach(0.004, 0.0)
    bends = [bench.effector.deflection[0]]
    for _ in range(15):
        bench.put(0.004, 0.0, 0.0)
        bends.append(bench.effector.deflection[0])
    steps = [abs(b - a) for a, b in pairwise(bends)]
    assert max(steps) < 0.0005
    assert bends[-1] == pytest.approx(-0.004)
    assert bench.rigid is not None
    tcp = deflected(bench.rigid, bench.effector.deflection)
    assert tcp[0] == pytest.approx(HUB[0], abs=1e-12)


def test_too_much_deflection_breaks_the_mount_away() -> None:
    bench = mated()
    bench.stay(0.1, x=0.0079)
    assert bench.contact.collision is None
    bench.stay(H, x=0.0081)
    assert bench.reason().startswith("mount overloaded: 8.1 mm")
    assert bench.contact.phase == "released"


def test_too_much_twist_breaks_the_mount_away() -> None:
    bench = mated()
    bench.put(0.0, 0.0, 0.0, (0.0, 0.0, 0.041))
    assert "41.0 mrad" in bench.reason()


def test_screws_take_their_time_turn_the_hub_and_are_reported() -> None:
    bench = mated()
    bench.contact.order(FIX_SCREWS)
    bench.stay(1.0)
    assert bench.contact.turned(HUB, bench.t) == HUB
    assert bench.contact.signals == 0
    bench.stay(0.028)
    turned = rotation.log(rotation.between(HUB[1], bench.contact.turned(HUB, bench.t)[1]))
    assert 0.3 < turned[0] / 1.2e-3 < 0.7
    bench.stay(0.032)
    turned = rotation.log(rotation.between(HUB[1], bench.contact.turned(HUB, bench.t)[1]))
    assert turned == pytest.approx((1.2e-3, -1.5e-3, 0.0))
    assert bench.contact.signals == SCREWS_FIXED
    assert bench.contact.fixed_s == pytest.approx(bench.t, abs=0.02)


def test_the_hubs_step_bends_the_held_tool() -> None:
    bench = mated()
    bench.contact.order(FIX_SCREWS)
    bench.stay(1.2)
    assert bench.effector.deflection[3:] == pytest.approx((1.2e-3, -1.5e-3, 0.0), abs=1e-9)


def test_an_order_taken_back_stops_the_nutrunner() -> None:
    bench = mated()
    bench.contact.order(FIX_SCREWS)
    bench.stay(0.5)
    bench.contact.order(0)
    bench.stay(1.0)
    assert bench.contact.fixed_s is None
    bench.contact.order(FIX_SCREWS)
    bench.stay(1.0)
    assert bench.contact.fixed_s is None
    bench.stay(0.06)
    assert bench.contact.fixed_s is not None


def test_screws_that_seat_are_not_stopped_by_taking_the_order_back() -> None:
    bench = mated()
    bench.contact.order(FIX_SCREWS)
    bench.stay(1.02)
    bench.contact.order(0)
    bench.stay(0.04)
    assert bench.contact.signals == SCREWS_FIXED


def test_orders_without_a_wheel_on_the_hub_do_nothing() -> None:
    bench = Bench()
    bench.contact.order(FIX_SCREWS | RELEASE_WHEEL)
    bench.stay(2.0, z=-0.1)
    assert bench.contact.signals == 0
    assert bench.contact.phase == "free"


def released() -> Bench:
    bench = mated()
    bench.contact.order(RELEASE_WHEEL)
    bench.stay(0.296)
    assert bench.contact.phase == "clamped"
    bench.stay(2 * H)
    assert bench.contact.phase == "released"
    assert bench.contact.signals == WHEEL_RELEASED
    return bench


def leave(bench: Bench) -> None:
    for k in range(40):
        bench.put(0.0, 0.0, -0.0005 * k)


def push(bench: Bench) -> None:
    bench.stay(0.1, z=0.0085)


def drag(bench: Bench) -> None:
    bench.stay(0.1, y=0.0125, z=-0.002)


def come_again(bench: Bench) -> None:
    leave(bench)
    for k in range(60):
        bench.put(0.0, 0.0, -0.02 + 0.0005 * k)


@pytest.mark.parametrize(
    ("act", "reason"),
    [
        (leave, None),
        (push, "pushed into the hub after release"),
        (drag, "dragged along the hub after release"),
        (come_again, "hit the hub again after release"),
    ],
)
def test_the_released_tool_must_leave_straight(
    act: Callable[[Bench], None], reason: str | None
) -> None:
    bench = released()
    act(bench)
    if reason is None:
        assert bench.contact.collision is None
    else:
        assert bench.reason().startswith(reason)


def test_the_first_collision_is_the_one_that_is_kept() -> None:
    bench = released()
    drag(bench)
    first = bench.contact.collision
    push(bench)
    assert bench.contact.collision is first
