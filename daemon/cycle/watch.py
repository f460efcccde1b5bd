"""Time-outs and debounce: from the facts of one cycle to the signals of the state machine.

Invariants:
- Pure. Time comes in as a stamp.
- One bad sample changes nothing. A link once lost must prove itself again.
- Limits depend on the state: in contact a stop is not safe, so missing telegrams are coasted over.
"""

from functools import lru_cache

from msgspec import Struct

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.cycle.states import Link, Machine, Signals, State

OPERATIONS = ("arm", "start", "stop", "retreat", "ack", "home", "follow")
"""An operator's orders, as ``Signals`` has them."""

NEAR_S = 1.0  # after a fault near the object in which the tool is withdrawn by itself [s]
IN_CONTACT = frozenset({State.CONTACT, State.RETREAT})
TASK = frozenset({State.TRACK, State.CONTACT, State.RETREAT, State.HOLD})


class Facts(Struct, frozen=True):
    """What one cycle showed, as it was.

    Attributes:
        unled_s: the robot had no setpoint for so long, by the controller's own count [s].
        new_session: the controller's program has started again.
        resynchronised: the counter or the controller's address has changed, the program goes on.
        wrong_cycle: why the controller's period cannot be followed, None if it can.
        position_ns: arrival of the newest accepted position, distance or camera [ns], or None.
        slower_ns: the same of that sensor of the two whose newest is older [ns]; None while the
            task waits, for the object may be out of the camera's sight.
        wrench_ns: arrival of the newest force [ns], or None.
        wrench_expected: there is a force-torque sensor.
        contradicted: the sensors of the position contradict each other.
        distance_lost: the distance sensor is excluded where it alone shows the object.
        gap_m: that a stop would leave between tool and object [m]; None while it is not seen, and
            in FAULT while the object stands.
        following_error: an axis is beyond the tolerance of its commands.
        clamped: a retreat waits for the clamp to open.
        closing: the tool is so near to its touch that a wait cannot prevent it any more.
        settling: the robot may still move although it was not sent anywhere yet.
        ready, object_left, contact, overload, outwaited, overdue, done, clear, fault: as in
            ``Signals``, raw.
        home_blocked: the robot cannot go home from where it is.
        orders: accepted orders that came since the last cycle.
    """

    stamp_ns: int
    telegram: bool
    unled_s: float = 0.0
    new_session: bool = False
    resynchronised: bool = False
    wrong_cycle: str | None = None
    position_ns: int | None = None
    slower_ns: int | None = None
    wrench_ns: int | None = None
    wrench_expected: bool = True
    contradicted: bool = False
    distance_lost: bool = False
    gap_m: float | None = None
    following_error: bool = False
    ready: bool = False
    object_left: bool = False
    contact: bool = False
    clamped: bool = False
    closing: bool = False
    settling: bool = False
    overload: bool = False
    outwaited: bool = False
    overdue: bool = False
    done: bool = False
    clear: bool = False
    fault: bool = False
    home_blocked: bool = True
    orders: frozenset[str] = frozenset()


class Watch(Struct, frozen=True):
    """What must be remembered from cycle to cycle.

    Attributes:
        link: state of the robot link.
        telegram_ns: stamp of the last cycle with a telegram [ns], or None.
        good: cycles with a telegram, in a row since the link came.
        stamp_ns: stamp of the last cycle [ns], or None.
        leak_ns: level of the leaky bucket [ns].
        contact, overload, following_error: cycles in a row that showed it.
        near: the tool was so near to the object, in motion or as that ended in the present fault,
            that it has to be withdrawn.
        interrupted: the present fault is a lost link that ended a motion of the task.
        state: the operating state as last seen.
    """

    link: Link = Link.LOST
    telegram_ns: int | None = None
    good: int = 0
    stamp_ns: int | None = None
    leak_ns: int = 0
    contact: int = 0
    overload: int = 0
    following_error: int = 0
    near: bool = False
    interrupted: bool = False
    state: State = State.INIT
    since_ns: int = 0


def observe(
    watch: Watch, facts: Facts, machine: Machine, settings: WatchSettings
) -> tuple[Watch, Signals]:
    """Judge one cycle.

    Args:
        machine: where the state machine stands before this cycle.

    Returns:
        What to remember, and the signals for ``states.transition``.
    """
    watch = _count(watch, facts, machine.state, settings)
    return watch, _signals(watch, facts, settings)


def _count(watch: Watch, facts: Facts, state: State, settings: WatchSettings) -> Watch:
    # A link that was lost, or a controller whose program started again, is not proven.
    restarts = facts.new_session or watch.link is Link.LOST
    most_ns = largest_leak_ns(settings, state)
    leak_ns = 0 if restarts else _leaked(watch, facts, most_ns)
    unproven = restarts or facts.resynchronised
    good = (0 if unproven else watch.good) + 1 if facts.telegram else 0
    telegram_ns = facts.stamp_ns if facts.telegram else watch.telegram_ns
    silent_s = _age_s(telegram_ns, facts.stamp_ns)
    in_contact = state in IN_CONTACT
    lost_s = settings.link_lost_in_contact_s if in_contact else settings.link_lost_s
    began = facts.new_session and watch.link is not Link.LOST
    if began or silent_s >= lost_s:
        link = Link.LOST
    elif watch.link is Link.HEALTHY:
        missed_s = settings.missed_in_contact_s if in_contact else settings.missed_s
        shaky = leak_ns >= most_ns or silent_s >= missed_s
        # A clock that stood still with this process does not fill the bucket.
        shaky = shaky or 2e9 * facts.unled_s >= most_ns
        shaky = shaky or facts.resynchronised or facts.wrong_cycle is not None
        link = Link.UNPROVEN if shaky else Link.HEALTHY
    else:
        proven = watch.link is Link.UNPROVEN and good >= settings.healthy_cycles
        proven = proven and facts.wrong_cycle is None
        link = Link.HEALTHY if proven else Link.UNPROVEN
    return Watch(
        link,
        telegram_ns,
        good,
        facts.stamp_ns,
        leak_ns,
        contact=watch.contact + 1 if facts.contact else 0,
        overload=watch.overload + 1 if facts.overload else 0,
        following_error=watch.following_error + 1 if facts.following_error else 0,
        near=_is_near(watch, facts, state, settings),
        interrupted=_is_interrupted(watch, facts, state, link),
        state=state,
        since_ns=watch.since_ns if state is watch.state else facts.stamp_ns,
    )


def _is_near(watch: Watch, facts: Facts, state: State, settings: WatchSettings) -> bool:
    """Return whether the tool is near the object, or was as its motion ended in a fault."""
    if state is State.FAULT:
        return watch.near and not facts.new_session
    moves = state in {State.TRACK, State.RETREAT}
    return moves and facts.gap_m is not None and facts.gap_m < settings.near_m


def _is_interrupted(watch: Watch, facts: Facts, state: State, link: Link) -> bool:
    """Return whether a lost link ended a motion of the task, whose programme goes on."""
    if facts.new_session:
        return False
    if state is State.FAULT:
        return watch.interrupted
    return state in TASK and link is Link.LOST


def _is_approached(watch: Watch, facts: Facts, settings: WatchSettings) -> bool:
    """Return whether an object that moves comes near a tool that a lost link has stopped.

    Only a link that has proven itself again counts, and only a robot that does what it is sent to.
    """
    if watch.state is not State.FAULT or not watch.interrupted or facts.gap_m is None:
        return False
    is_seen = _age_s(facts.position_ns, facts.stamp_ns) <= settings.position_s
    is_led = watch.link is Link.HEALTHY and not (facts.fault or watch.following_error)
    return is_seen and is_led and facts.gap_m < settings.near_m


def largest_leak_ns(settings: WatchSettings, state: State) -> int:
    """Return the level of the leaky bucket at which the link is unproven [ns].

    In contact that of a silence that ends it: telegrams missed now and then pull at the mount too.
    """
    longest_s = 2.0 * settings.missed_in_contact_s if state in IN_CONTACT else settings.leak_s
    return round(longest_s * 1e9)


def largest_position_age(settings: WatchSettings, state: State, facts: Facts) -> float:
    """Return the age of the newest position beyond which tracking stops [s].

    A tool that touches within 0.3 s goes on by itself: it needs what one in contact needs.
    """
    touches = state in IN_CONTACT or facts.closing
    return settings.position_in_contact_s if touches else settings.position_s


def _leaked(watch: Watch, facts: Facts, most_ns: int) -> int:
    """Return the level of the leaky bucket one cycle later, at most ``most_ns`` [ns]."""
    passed_ns = 0 if watch.stamp_ns is None else max(0, facts.stamp_ns - watch.stamp_ns)
    level_ns = watch.leak_ns + (-passed_ns if facts.telegram else 2 * passed_ns)
    return max(0, min(level_ns, most_ns))


def _signals(watch: Watch, facts: Facts, settings: WatchSettings) -> Signals:
    stamp_ns = facts.stamp_ns
    coasting = watch.state in IN_CONTACT
    oldest_s = largest_position_age(settings, watch.state, facts)
    both = coasting or facts.slower_ns is None
    both = both or _age_s(facts.slower_ns, stamp_ns) <= settings.one_sensor_s
    position_fresh = _age_s(facts.position_ns, stamp_ns) <= oldest_s and both
    position_fresh = position_fresh and not (facts.contradicted or facts.distance_lost)
    wrench_fresh = _age_s(facts.wrench_ns, stamp_ns) <= settings.wrench_s
    wrench_fresh = wrench_fresh or not facts.wrench_expected
    fault = facts.fault or watch.following_error >= settings.cycles_astray
    trouble = fault or "stop" in facts.orders or watch.link is not Link.HEALTHY
    trouble = trouble or facts.object_left or not (position_fresh and wrench_fresh)
    # A stop this near to the object would end in contact. So does a hold as the object goes on.
    trouble = trouble or watch.state is State.HOLD
    if watch.state is State.FAULT:
        is_at_object = watch.near or _is_approached(watch, facts, settings)
    else:
        is_at_object = trouble and facts.gap_m is not None and facts.gap_m < settings.near_m
    contact = is_at_object or watch.contact >= settings.cycles_of_contact
    return _seen(
        watch.link,
        position_fresh,
        wrench_fresh,
        facts.ready,
        facts.object_left,
        contact,
        watch.overload >= settings.cycles_of_overload,
        facts.outwaited,
        facts.overdue,
        facts.done,
        facts.clear,
        _expired(watch, facts, settings),
        fault,
        *(_ordered(_possible(facts)) if facts.orders else _NO_ORDER),
    )


def _possible(facts: Facts) -> frozenset[str]:
    """Return the orders without a way home that has become impossible since it was ordered."""
    return facts.orders - {"home"} if facts.home_blocked else facts.orders


def _ordered(orders: frozenset[str]) -> tuple[bool, ...]:
    return tuple([op in orders for op in OPERATIONS])


_NO_ORDER = _ordered(frozenset())


_seen = lru_cache(maxsize=512)(Signals)
"""Signals of earlier cycles: most cycles have the same."""


def _expired(watch: Watch, facts: Facts, settings: WatchSettings) -> bool:
    """Return whether the present state has lasted too long."""
    lasted_s = _age_s(watch.since_ns, facts.stamp_ns)
    if watch.state is State.HOLD:
        return lasted_s > settings.longest_hold_s
    if watch.state is State.FAULT:
        return _is_too_late(watch, facts, settings, lasted_s)
    if watch.state is State.HOME:
        return lasted_s > settings.longest_home_s
    if watch.state is not State.RETREAT:
        return False
    if facts.clamped:
        # A stop would pull at the closed clamp as the object goes on. Without any sensor the
        # prediction is good for the clamp's own time-out, not for longer.
        return facts.overdue and _is_blind(facts, settings)
    return lasted_s > settings.longest_retreat_s


def _is_too_late(watch: Watch, facts: Facts, settings: WatchSettings, lasted_s: float) -> bool:
    """Return whether a tool in FAULT may not be withdrawn by itself any more, or not yet.

    It may only from where it rests. One that is not clamped must be gone sooner: someone may come
    near. One that an object comes near is withdrawn for as long as from a HOLD.
    """
    if _is_approached(watch, facts, settings):
        return facts.settling or lasted_s > settings.longest_hold_s
    if not (facts.contact or watch.near):
        return False
    late = lasted_s > (settings.longest_retreat_s if facts.contact else NEAR_S)
    return facts.settling or late or (facts.overdue and _is_blind(facts, settings))


def _is_blind(facts: Facts, settings: WatchSettings) -> bool:
    """Return whether no sensor shows the clamped object, neither its position nor its force."""
    has_position = _age_s(facts.position_ns, facts.stamp_ns) <= settings.position_in_contact_s
    has_force = _age_s(facts.wrench_ns, facts.stamp_ns) <= settings.wrench_s
    return not (has_position or has_force)


def _age_s(then_ns: int | None, now_ns: int) -> float:
    return float("inf") if then_ns is None else (now_ns - then_ns) / 1e9
