"""Oracles of the fault campaign that judge a run by the plant's truth.

Invariants:
- Positions, forces and sensor silence come from the plant and from the emulated links.
- Of the daemon only the operating state is read: it is what is judged.
- An oracle never changes a run.
"""

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace

from linemate.daemon.cycle.states import State
from linemate.simulators.harness.sensor_links import Emitters
from linemate.simulators.lab.faults.dst_unavoidable import Harm, Loss, excuse
from linemate.simulators.plants import rotation
from linemate.simulators.plants.effector import deflected
from linemate.simulators.plants.world import World

MOST_FORCE_N = 200.0
"""Largest force between tool and hub that a run may end with [N]: rows X1, X8 and X10."""
MOST_SWING_N = 300.0
"""Largest force in the mount of a free tool that a retreat may make, if all replies arrive [N]."""
SWUNG_S = 0.2
"""A swing that was there before shows in this time [s]: a period of 5 Hz."""
AT_HUB_M = 0.02
"""A tool this near to the hub plane is at the hub [m]."""
MOST_LATERAL_M = 0.006
"""Lateral offset that the tool's capture tolerates [m]."""
LATERAL_S = 0.05
"""Longest time of a larger lateral offset in TRACK or CONTACT [s]."""
MOST_RAIL_M = 0.05
"""The rail's change relative to the object since the tool came near [m]: row X11."""
NEAR_M = 0.055
SCREWS_S = 0.1
"""Screws may be ordered for so long while nothing is clamped [s]."""

POSITION_S = 0.3
POSITION_IN_CONTACT_S = 0.16
WRENCH_S = 0.16
COMMANDS_S = 0.1
COMMANDS_IN_CONTACT_S = 0.3
"""After so much true silence the daemon has to leave TRACK and CONTACT [s], but for"""
REACTION_S = 0.06
"""a debounce of two cycles and what a telegram is late [s]."""
COMMANDS_REACTION_S = 0.15
"""A lost reply is known from the telegram after it, which may be lost as well [s]."""
FROZEN_S = 0.25
"""A frozen reading is known to be frozen after so much more [s]."""
BRAKED_M = 0.011
BRAKED_S = 0.45
"""A braked axis may be so far from its setpoint [rad, m] for so long [s]."""
OVERLOAD_N = 400.0
OVERLOAD_S = 0.06
"""A sensor that says so much [N] ends TRACK and CONTACT within this time [s]."""
UNANSWERED_S = 0.12
"""A new session, or one that has to be proven, may cost so much [s]."""
RESTING_UNANSWERED_S = 0.6
"""The same for a controller that says nothing of the setpoint in force. Its robot has to rest for
0.12 s first, after servos that settle; FANUC's stream is asked for every 0.5 s [s]."""
MOST_CYCLE_OFF = 0.055
"""A controller whose cycle is farther off must not lead: row X16."""
UNFELT_S = 0.4
"""A clamped tool is felt within this time [s]."""
PHANTOM_M = 0.01
PHANTOM_FORCE_N = 150.0
PHANTOM_S = 0.3
"""Contact is not felt so far from the hub [m], nor an overload below that force [N], unless a
wrench was wrong within this time [s]."""
MOST_LOSSES = 32
STILL = 1e-4
"""A setpoint that changed by less in a cycle did not move its axis [rad, m]."""
BOUND = frozenset({State.TRACK, State.CONTACT})

BUILD_UP_S = 0.01
"""An axis builds its greatest acceleration up in no less time [s]. The servo's motion over two
cycles is judged: at 12 ms the jerk of setpoints cannot exceed its limit, for the limit of the
acceleration is reached before."""
AT_REST = 0.005
"""A robot whose axes are all slower stands [rad/s, m/s]."""
SETTLING_S = 0.1
"""So long after a cycle that was not answered the servos still react to it [s]."""


@dataclass(frozen=True, slots=True)
class Seen:
    """What one cycle of the controller showed, from outside of the daemon.

    Attributes:
        now_s: scenario time at its end [s].
        state: the daemon's, None while there is no daemon.
        because: why it is in that state.
        answered: a reply was taken in this cycle.
        programme: the controller's programme runs and its drives are on.
        busy_s: until when the daemon was stalled or not yet started [s].
        sent: where the controller was sent last, A1..A6 [rad], E1 [m].
        stands: where the axes are held while the drives are off, None while they are on.
        screws: the tool is ordered to fix the screws.
        is_heard: the links to and from the daemon carry telegrams whose counter can be read.
        readable: the values of this cycle's telegram can be read. Else its reply must be bare.
    """

    now_s: float
    state: State | None
    because: str
    answered: bool
    programme: bool
    busy_s: float
    sent: tuple[float, ...]
    stands: tuple[float, ...] | None
    screws: bool
    is_heard: bool = True
    readable: bool = True


class PlantOracle:
    """Judges tool, hub, force, sensor silence and motion of one run.

    Attributes:
        excused: what was found and is unavoidable by the plan, with the loss that excuses it.
        largest_n: largest force between the hub and a clamped tool so far [N].
    """

    def __init__(
        self,
        world: World,
        emitters: Emitters,
        cycle_s: float,
        blame: Callable[[str], None],
        cycle_off: float = 0.0,
        *,
        has_rail: bool = True,
        unanswered_s: float = UNANSWERED_S,
    ) -> None:
        """Begin before the first cycle.

        Args:
            emitters: the sensors' ends of the links.
            cycle_off: by what share the controller's cycle is not the configured one.
            has_rail: the daemon moves E1.
            unanswered_s: longest time without answers to telegrams that were heard [s].
        """
        self._unanswered_s = unanswered_s
        self.excused: list[str] = []
        self.largest_n = 0.0
        self._world, self._emitters, self._cycle_s = world, emitters, cycle_s
        self._blame = blame
        self._cycle_off, self._has_rail = cycle_off, has_rail
        self._reported: set[str] = set()
        self._open: dict[str, _OpenLoss] = {}
        self._losses: deque[Loss] = deque(maxlen=MOST_LOSSES)
        self._since: dict[str, float] = {}
        self._state: State | None = None
        self._sent: tuple[float, ...] = ()
        self._answered_s = -math.inf
        self._settling = math.ceil(SETTLING_S / cycle_s)
        self._quiet = self._settling
        self._is_driven = False
        self._jerks = tuple(
            axis.acceleration_limit / BUILD_UP_S for axis in world.scenario.robot.axes
        )
        self._velocities: deque[tuple[float, ...]] = deque(maxlen=3)
        self._rail: float | None = None
        self._forces: deque[float] = deque(maxlen=max(1, round(0.2 / cycle_s)))
        self._swung = 0.0
        self._stiffness = world.scenario.effector.stiffness[0]

    def judge_cycle(self, seen: Seen) -> None:
        """Judge one cycle."""
        world = self._world
        rigid, hub, bent = world.rigid(), world.hub(), world.deflection()
        x, y, depth = rotation.unapply(hub[1], _minus(deflected(rigid, bent)[0], hub[0]))
        lateral = math.hypot(x, y)
        clamped = world.contact == "clamped"
        at_hub = clamped or (depth > -AT_HUB_M and lateral < 2.0 * AT_HUB_M)
        force = self._stiffness * math.hypot(*bent[:3])
        self._forces.append(force)
        if clamped:
            self.largest_n = max(self.largest_n, force)
        if seen.answered:
            self._answered_s = seen.now_s
        held = clamped or depth > -AT_HUB_M
        self._track_losses(seen, hub[0], at_hub=at_hub, held=held)
        self._judge_contact(seen, force if clamped else 0.0)
        self._judge_swing(seen, 0.0 if clamped else force)
        self._judge_place(seen, lateral, depth, clamped=clamped)
        self._judge_silence(seen, clamped=clamped)
        self._judge_answers(seen)
        self._judge_motion(seen)
        if seen.state is not self._state:
            self._judge_phantom(seen, depth, clamped=clamped)
            self._state = seen.state

    # What was taken away.

    def _track_losses(
        self, seen: Seen, hub: tuple[float, float, float], *, at_hub: bool, held: bool
    ) -> None:
        """Keep what is missing and since when.

        Args:
            held: the tool is not off the hub: clamped, or not 20 mm before the hub plane.
        """
        now_s = seen.now_s
        moved = any(abs(a - b) > STILL for a, b in zip(seen.sent, self._sent, strict=False))
        was_moved = seen.answered and seen.programme and moved
        self._sent = seen.sent
        position_s = max(self._emitters.true_s("distance"), self._emitters.true_s("camera"))
        lost = {
            "commands": not seen.answered or not (seen.readable or moved),
            "position": now_s - position_s > 2.0 * self._cycle_s,
            # It lasts until the tool is off the hub, whatever comes back before.
            "programme": not seen.programme
            or seen.state is None
            or ("programme" in self._open and held),
        }
        for what, is_lost in lost.items():
            opened = self._open.get(what)
            if is_lost and opened is None:
                self._open[what] = _OpenLoss(
                    Loss(what, now_s, math.inf, at_hub, 0.0, 0.0),  # type: ignore[arg-type]
                    hub,
                    self._world.unit_speed(),
                )
            elif opened is not None:
                opened.go_on(hub, self._world.unit_speed(), was_moved=was_moved)
                if not is_lost:
                    self._losses.append(replace(opened.loss, end_s=now_s))
                    del self._open[what]

    def _harm(self, what: str, figures: str, at_s: float, harm: Harm = "collision") -> None:
        """Report each kind of harm once, unless the plan made it unavoidable."""
        if what in self._reported:
            return
        self._reported.add(what)
        loss = excuse(harm, at_s, (*self._losses, *(span.loss for span in self._open.values())))
        if loss is None:
            self._blame(f"{what}: {figures}")
        else:
            self.excused.append(f"{what}: {figures}: {loss.what} lost since {loss.begin_s:.3f} s")

    def _judge_contact(self, seen: Seen, force: float) -> None:
        collision = self._world.collision
        if collision is not None and "collision" not in self._reported:
            self._harm("collision", f"{collision.reason}, in {_name(seen.state)}", seen.now_s)
            # One accident: the force that led to it is not reported again.
            self._reported.add("force")
        if force > MOST_FORCE_N:
            self._harm("force", f"{force:.0f} N, limit {MOST_FORCE_N:g}", seen.now_s, "force")

    def _judge_swing(self, seen: Seen, force: float) -> None:
        """A retreat that gets all its replies makes no free tool swing."""
        is_led = seen.state is State.RETREAT and seen.answered and self._quiet >= self._settling
        if self._lasting("led", is_led, seen.now_s) < SWUNG_S:
            self._swung = max(self._forces)
        elif force > MOST_SWING_N and self._swung < MOST_FORCE_N:
            self._once("swing", f"{force:.0f} N, limit {MOST_SWING_N:g}, in a retreat")

    # Where the tool is.

    def _judge_place(self, seen: Seen, lateral: float, depth: float, *, clamped: bool) -> None:
        # A daemon that had no processor shows the state that it had before.
        runs = seen.now_s > seen.busy_s + SETTLING_S
        bound = seen.state in BOUND and seen.programme and runs
        off = bound and not clamped and depth > -AT_HUB_M and lateral > MOST_LATERAL_M
        if self._lasting("lateral", off, seen.now_s) > LATERAL_S:
            self._harm(
                "place",
                f"tool {1e3 * lateral:.1f} mm off the hub axis, limit {1e3 * MOST_LATERAL_M:g}, in"
                f" {_name(seen.state)}",
                seen.now_s,
            )
        in_air = seen.screws and self._world.contact == "free"
        if self._lasting("screws", in_air, seen.now_s) > SCREWS_S:
            self._harm("screws", f"ordered {-1e3 * depth:.1f} mm before the hub", seen.now_s)
        if not (bound and self._has_rail):
            self._rail = None
            return
        rail = self._world.encoders()[6] - self._world.unit_position()
        if self._rail is None and depth > -NEAR_M:
            self._rail = rail
        if self._rail is not None and abs(rail - self._rail) > MOST_RAIL_M + NEAR_M:
            self._harm("rail", f"{1e3 * (rail - self._rail):.0f} mm from the object", seen.now_s)

    # From silence to reaction.

    def _judge_silence(self, seen: Seen, *, clamped: bool) -> None:
        emitters, now_s = self._emitters, seen.now_s
        in_contact = seen.state is State.CONTACT
        # A contact that was felt a moment ago is granted its own reaction.
        is_settled = self._lasting("contact", in_contact, now_s) > REACTION_S
        unfelt = clamped and seen.state is State.TRACK
        if self._lasting("unfelt", unfelt, now_s) > UNFELT_S:
            self._once("reaction", f"TRACK after {UNFELT_S:g} s with the tool clamped")
        if seen.state not in BOUND:
            self._since.pop("overload", None)
            self._since.pop("braked", None)
            self._since.pop("bound", None)
            return
        # A state that was entered a moment ago is granted its own reaction.
        begun_s = max(seen.busy_s, self._since.setdefault("bound", now_s))
        position_s = max(emitters.heard_s("distance"), emitters.heard_s("camera"))
        most_s = POSITION_IN_CONTACT_S if is_settled else POSITION_S
        self._silence("position", now_s - max(position_s, seen.busy_s), most_s + REACTION_S)
        if emitters.has_wrench:
            silent_s = now_s - max(emitters.heard_s("force_torque"), seen.busy_s)
            self._silence("wrench", silent_s, WRENCH_S + REACTION_S)
            frozen_s = now_s - max(emitters.moved_s("force_torque"), begun_s)
            self._silence("wrench frozen", frozen_s, WRENCH_S + REACTION_S + FROZEN_S)
            overloaded = emitters.wrench_n > OVERLOAD_N and silent_s < self._cycle_s
            overloaded = overloaded and now_s > seen.busy_s
            if self._lasting("overload", overloaded, now_s) > OVERLOAD_S:
                self._once("reaction", f"overload of {emitters.wrench_n:.0f} N goes on")
        unheard_s = now_s - max(self._answered_s, seen.busy_s)
        most_s = COMMANDS_IN_CONTACT_S if in_contact else COMMANDS_S
        self._silence("commands", unheard_s, most_s + COMMANDS_REACTION_S)
        off = seen.stands is not None and any(
            abs(a - b) > BRAKED_M for a, b in zip(seen.sent, seen.stands, strict=True)
        )
        if self._lasting("braked", off, now_s) > BRAKED_S:
            self._once("reaction", f"the axes are braked for {BRAKED_S:g} s")

    def _judge_answers(self, seen: Seen) -> None:
        """A telegram whose counter can be read is answered, whatever else is in it."""
        ready = seen.state is not None and seen.programme and seen.is_heard
        ready = ready and seen.now_s > seen.busy_s + self._cycle_s
        unanswered_s = self._lasting("unanswered", ready and not seen.answered, seen.now_s)
        if unanswered_s > self._unanswered_s:
            self._once("answer", f"none for {unanswered_s:.3f} s to telegrams that were heard")
        if seen.state in BOUND and abs(self._cycle_off) > MOST_CYCLE_OFF:
            self._once(
                "cycle", f"{_name(seen.state)} at a cycle {100 * self._cycle_off:+.1f} % off"
            )

    def _silence(self, what: str, silent_s: float, most_s: float) -> None:
        if silent_s > most_s:
            self._once(
                "reaction", f"motion after {silent_s:.3f} s without {what}, limit {most_s:g}"
            )

    def _judge_phantom(self, seen: Seen, depth: float, *, clamped: bool) -> None:
        """A cause that the daemon names and the plant does not know."""
        if seen.now_s - self._emitters.wrong_s("force_torque") < PHANTOM_S:
            return
        if seen.state is State.CONTACT and not clamped and depth < -PHANTOM_M:
            self._once("phantom", f"contact {-1e3 * depth:.1f} mm before the hub")
        if seen.state is State.RETREAT and seen.because == "overload":
            force = max(self._forces)
            if force < PHANTOM_FORCE_N:
                self._once("phantom", f"overload, and the mount bore {force:.0f} N at most")

    # How the servos move.

    def _judge_motion(self, seen: Seen) -> None:
        self._velocities.append(self._world.velocities)
        # The programme's own motion is not the daemon's: it lasts until the robot stands.
        moves = max(map(abs, self._velocities[-1])) >= AT_REST
        stands = self._lasting("rest", not moves, seen.now_s) > SETTLING_S
        self._is_driven = not seen.programme or (self._is_driven and not stands)
        self._quiet = self._quiet + 1 if seen.answered and not self._is_driven else 0
        if self._quiet < self._settling or len(self._velocities) < 3:
            return
        first, middle, last = self._velocities
        for axis, (u, v, w, most) in enumerate(zip(first, middle, last, self._jerks, strict=True)):
            jerk = abs(u - 2.0 * v + w) / self._cycle_s**2
            if jerk > most:
                self._once("jerk", f"{jerk:.0f} of axis {axis}'s servo, limit {most:g}")

    # Help.

    def _lasting(self, what: str, holds: bool, now_s: float) -> float:
        """Return for how long something has held [s]."""
        if not holds:
            self._since.pop(what, None)
            return 0.0
        return now_s - self._since.setdefault(what, now_s)

    def _once(self, kind: str, figures: str) -> None:
        if kind not in self._reported:
            self._reported.add(kind)
            self._blame(f"{kind}: {figures}")


class _OpenLoss:
    """A loss that goes on."""

    def __init__(self, loss: Loss, hub: tuple[float, float, float], speed: float) -> None:
        self.loss = loss
        self._hub, self._speed = hub, speed

    def go_on(self, hub: tuple[float, float, float], speed: float, *, was_moved: bool) -> None:
        """Note how far the hub is from where it was, and the change of the line's speed."""
        self.loss = replace(
            self.loss,
            travel_m=max(self.loss.travel_m, math.dist(hub, self._hub)),
            speed_change=max(self.loss.speed_change, abs(speed - self._speed)),
            was_moved=self.loss.was_moved or was_moved,
        )


def _minus(a: tuple[float, ...], b: tuple[float, ...]) -> tuple[float, float, float]:
    return a[0] - b[0], a[1] - b[1], a[2] - b[2]


def _name(state: State | None) -> str:
    return "no daemon" if state is None else state.upper()
