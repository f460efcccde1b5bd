"""State table of go or no-go before contact: from evidence to the order for the task's clock.

Invariants:
- Pure. Reasons and zone alone decide; values only enter the reasons.
- After a no-go the way is free only when no reason has held for ``CLEAR_S``. A check that is only
  missing yet needs no such time: it does not come and go.
- Where a clamp may have closed the tool stands and does not back off.
- A tool that backs off does so up to the far gate: turning back midway excites it, and a force of
  its own inertia looks like a touch.
- A change of class that no image has shown makes the tool back off at once: it has to look. So do
  bolts that do not enter.
- In the final zone the decision is over: the touch has begun.
"""

import math
from enum import StrEnum

from msgspec import Struct

from linemate.daemon.core.tracking.task import GuardedApproach

CLEAR_S = 0.2  # time without a reason after which a waiting tool goes on [s]
BACK_S = 0.25  # a no-go on the way that lasts longer makes the tool back off to the far gate [s]
DECIDED_S = 0.7  # the same if a change of class is the only reason: it is decided until then [s]
RELEASE_SHARE = 0.85  # of a limit, below which a waiting tool takes it for met
LOOK_S = 0.6  # images of the object after a change of class, before the touch [s]
STEADY_S = 0.25  # time since a change of class, before the touch [s]
POSITION_S = 0.12  # age of the newest of distance and camera that is normal near the object [s]
DEVIATIONS = 3.0  # sigmas of the estimate that must be within the tolerance
LARGEST_NIS = 16.0  # average normalised innovation squared of a camera
REJECTED = 4  # poses rejected in a row


class Zone(StrEnum):
    """Where the tool is on its last approach."""

    FAR = "far"  # up to the last waypoint before contact
    MIDDLE = "middle"  # from there to the clearance
    NEAR = "near"  # the step in which the clearance is reached
    CLOSE = "close"  # within the clearance
    LAST = "last"  # the last step before the touch cannot be prevented
    FINAL = "final"


class GoOrder(StrEnum):
    """What the task's clock does."""

    GO = "go"
    STAND = "stand"
    BACK = "back"


class Reason(StrEnum):
    """Why the tool does not go on."""

    SIGHT = "sight"
    POSITION = "position"
    UNCHECKED = "unchecked"
    PREDICTION = "prediction"
    ANGLE = "angle"
    DISTANCE = "distance"
    COVARIANCE = "covariance"
    INNOVATION = "innovation"
    FOLLOWING = "following"
    CHANGE = "change"
    UNSEEN = "unseen"
    TURN = "turn"
    BOLTS = "bolts"
    FORCE = "force"


_ALWAYS = frozenset(
    {
        Reason.POSITION,
        Reason.PREDICTION,
        Reason.ANGLE,
        Reason.DISTANCE,
        Reason.COVARIANCE,
        Reason.INNOVATION,
        Reason.FOLLOWING,
        Reason.UNSEEN,
        Reason.TURN,
        Reason.BOLTS,
        Reason.FORCE,
    }
)
_BACK_AT_ONCE = frozenset({Reason.UNSEEN, Reason.TURN, Reason.BOLTS})

COUNTED: dict[Zone, frozenset[Reason]] = {
    Zone.FAR: frozenset(Reason),
    Zone.MIDDLE: _ALWAYS | {Reason.SIGHT},
    Zone.NEAR: _ALWAYS | {Reason.SIGHT, Reason.CHANGE},
    Zone.CLOSE: _ALWAYS | {Reason.SIGHT},
    Zone.LAST: _ALWAYS | {Reason.SIGHT, Reason.CHANGE},
    Zone.FINAL: frozenset(),
}
"""Reasons that count in a zone. A change of class may become certain on the way."""

TODO: dict[Reason, str] = {
    Reason.SIGHT: "Check the camera's view and camera.blind_below.",
    Reason.POSITION: "Check the distance sensor and the camera.",
    Reason.UNCHECKED: "Wait, or check the camera's rate.",
    Reason.PREDICTION: "Let the object come to rest; identify its swing, the camera and the arm.",
    Reason.ANGLE: "Let the object come to rest; check the camera's mounting.",
    Reason.DISTANCE: "Check the distance sensor against the camera.",
    Reason.COVARIANCE: "Check the camera's noise and rate.",
    Reason.INNOVATION: "Check the camera's noise settings and calibration.",
    Reason.FOLLOWING: "Check the drives and the servo models.",
    Reason.CHANGE: "Wait for the conveyor.",
    Reason.UNSEEN: "Wait, or identify the sway: record stops that the camera sees.",
    Reason.TURN: "Wait, or check the angle of the wheel.",
    Reason.BOLTS: "Check the angle of the wheel and of the bolts, and the camera's mounting.",
    Reason.FORCE: "Check the force-torque sensor, and that nothing touches the tool.",
}
ALONG_TODO = (
    "Most of it is along the conveyor: let the object come to rest, identify its sway, and check "
    "the distance sensor."
)
"""For a covariance that the camera does not make."""


class GoEvidence(Struct, frozen=True):
    """What a decision is made from.

    Attributes:
        sight_s: age of the camera's last accepted pose; 0 where the camera is blind by its
            configuration [s].
        position_s: age of the newest of distance and camera [s].
        checked_s: for how long predictions have been compared with images [s].
        prediction: error of past predictions across the tool's axis, the larger lead [m].
        angle: the same of the orientation [rad].
        distance: mean error of the conveyor's predicted position against the readings [m].
        deviation: one sigma of the object across the tool's axis at the contact [m].
        angle_deviation: the same of its orientation [rad].
        nis: average normalised innovation squared of the camera.
        rejected: poses rejected in a row.
        following: mean distance of the tcp from its plan, and of the plan from the estimate [m].
        tentative: a change of the conveyor's class is tentative that moves the object by more than
            is tolerated before the tool follows it.
        steady_s: time since the last change of class was confirmed [s].
        looked_s: for how long the camera has seen the object since a change of class that can make
            it sway by more than is known; infinity without one [s].
        turns: the bolts did not enter: the tool backs off, and turns to another angle.
        jams: nor did they at any other angle.
        force: that a tool has which stands where it cannot touch; None for none [N].
        along: the part of ``deviation`` along the conveyor [m].
    """

    sight_s: float
    checked_s: float
    prediction: float
    angle: float
    distance: float
    deviation: float
    angle_deviation: float
    nis: float
    rejected: int
    following: float
    tentative: bool
    steady_s: float
    position_s: float = 0.0
    looked_s: float = math.inf
    turns: bool = False
    jams: bool = False
    force: float | None = None
    along: float = 0.0


class GoState(Struct, frozen=True):
    """The decision so far.

    Attributes:
        reasons: that count now or did less than ``CLEAR_S`` ago.
        text: the first of them in words, with value and limit; None without a reason.
        clear_s: time without a reason but a missing check [s].
        lasted_s: time since the no-go began [s].
        waited_s: time that the task's clock has stood or gone back for it, in all [s].
    """

    order: GoOrder = GoOrder.GO
    reasons: tuple[Reason, ...] = ()
    text: str | None = None
    clear_s: float = 0.0
    lasted_s: float = 0.0
    waited_s: float = 0.0


GO = GoState()


def next_state(
    state: GoState,
    reasons: tuple[Reason, ...],
    zone: Zone,
    dt: float,
    *,
    stands: bool,
    may_back: bool,
) -> GoState:
    """Return the decision one step later.

    Args:
        reasons: that hold now; those that do not count in the zone are left out here.
        stands: the tool is at the far gate, so that a no-go makes it wait.
        may_back: no clamp can have closed on the object.
    """
    counted = tuple(reason for reason in reasons if reason in COUNTED[zone])
    if zone is Zone.FINAL or (not counted and state.order is GoOrder.GO):
        return _gone(state)
    clear_s = CLEAR_S if state.order is GoOrder.GO else state.clear_s + dt
    if any(reason is not Reason.UNCHECKED for reason in counted):
        clear_s = 0.0
    is_returning = state.order is GoOrder.BACK and zone is not Zone.FAR and may_back
    if not counted and clear_s >= CLEAR_S and not is_returning:
        return _gone(state)
    lasted_s = 0.0 if state.order is GoOrder.GO else state.lasted_s + dt
    order = GoOrder.STAND
    # A reason that has just ended is waited out: the way back and again takes seconds.
    longest_s = DECIDED_S if counted == (Reason.CHANGE,) else BACK_S
    is_late = state.order is GoOrder.BACK or (bool(counted) and lasted_s >= longest_s)
    is_late = is_late or not _BACK_AT_ONCE.isdisjoint(counted)
    if zone is not Zone.FAR and may_back and is_late:
        order = GoOrder.BACK
    waits = stands or zone is not Zone.FAR
    waited_s = state.waited_s + dt if waits else state.waited_s
    if Reason.TURN in counted:
        waited_s = 0.0  # Each attempt may wait as long; their number is bounded.
    shown = counted or state.reasons
    return GoState(order, shown, state.text, clear_s, lasted_s, waited_s)


def _gone(state: GoState) -> GoState:
    """Return the decision to go on; the time waited is kept."""
    return state if state.order is GoOrder.GO else GoState(waited_s=state.waited_s)


def find_reasons(
    evidence: GoEvidence, guard: GuardedApproach, *, waiting: bool
) -> tuple[Reason, ...]:
    """Return the reasons that hold.

    Args:
        waiting: the tool waits: what made it wait must be clearly better.
    """
    share = RELEASE_SHARE if waiting else 1.0
    place, turn = share * guard.tolerance, share * guard.angle_tolerance
    lacking = (
        (Reason.SIGHT, evidence.sight_s > guard.sight),
        (Reason.POSITION, evidence.position_s > POSITION_S),
        (Reason.UNCHECKED, evidence.checked_s < guard.checked),
        (Reason.PREDICTION, evidence.prediction > place),
        (Reason.ANGLE, evidence.angle > turn),
        (Reason.DISTANCE, abs(evidence.distance) > place),
        (
            Reason.COVARIANCE,
            DEVIATIONS * evidence.deviation > place or DEVIATIONS * evidence.angle_deviation > turn,
        ),
        (Reason.INNOVATION, evidence.nis > LARGEST_NIS or evidence.rejected >= REJECTED),
        (Reason.FOLLOWING, evidence.following > place),
        (Reason.CHANGE, evidence.tentative or evidence.steady_s < STEADY_S),
        (Reason.UNSEEN, evidence.looked_s < LOOK_S),
        (Reason.TURN, evidence.turns),
        (Reason.BOLTS, evidence.jams),
        (Reason.FORCE, evidence.force is not None),
    )
    return tuple([reason for reason, holds in lacking if holds])


def describe(
    reason: Reason, evidence: GoEvidence, guard: GuardedApproach, *, waiting: bool = False
) -> str:
    """Return a reason in words: what is wrong, value and limit, and what to do.

    Args:
        waiting: as of ``find_reasons``, whose limits it has.
    """
    share = RELEASE_SHARE if waiting else 1.0
    place = f"limit {1e3 * share * guard.tolerance:.1f} mm"
    turn = f"{1e3 * share * guard.angle_tolerance:.0f} mrad"
    whats = {
        Reason.SIGHT: f"no camera pose for {evidence.sight_s:.2f} s, limit {guard.sight:.2f} s",
        Reason.POSITION: (
            f"neither distance nor camera for {evidence.position_s:.2f} s, limit {POSITION_S:.2f} s"
        ),
        Reason.UNCHECKED: (
            f"predictions checked for {evidence.checked_s:.1f} s, {guard.checked:.1f} s needed"
        ),
        Reason.PREDICTION: f"prediction error {1e3 * evidence.prediction:.1f} mm, {place}",
        Reason.ANGLE: f"prediction error {1e3 * evidence.angle:.0f} mrad, limit {turn}",
        Reason.DISTANCE: (
            f"distance sensor {1e3 * evidence.distance:.1f} mm from the prediction, {place}"
        ),
        Reason.COVARIANCE: (
            f"three sigma at the contact {1e3 * DEVIATIONS * evidence.deviation:.1f} mm and "
            f"{1e3 * DEVIATIONS * evidence.angle_deviation:.0f} mrad, {place} and {turn}"
        ),
        Reason.INNOVATION: (
            f"camera poses do not fit the estimate: NIS {evidence.nis:.0f}, limit "
            f"{LARGEST_NIS:.0f}, {evidence.rejected} rejected in a row"
        ),
        Reason.FOLLOWING: f"the tcp is {1e3 * evidence.following:.1f} mm off its plan, {place}",
        Reason.CHANGE: "the conveyor's motion is changing",
        Reason.UNSEEN: (
            f"object seen for {evidence.looked_s:.1f} s since the conveyor's motion changed, "
            f"{LOOK_S:.1f} s needed"
        ),
        Reason.TURN: "the bolts did not enter, the tool turns to another angle",
        Reason.BOLTS: "the bolts enter at none of the angles",
        Reason.FORCE: f"a force of {evidence.force or 0.0:.0f} N without a touch",
    }
    is_along = reason is Reason.COVARIANCE and 2.0 * evidence.along**2 > evidence.deviation**2
    return f"{whats[reason]}. {ALONG_TODO if is_along else TODO[reason]}"
