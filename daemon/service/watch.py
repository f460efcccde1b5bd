"""Time-outs and debounce: from what one cycle showed to the signals of the state machine.

Law of this file: pure; time comes in as a stamp. One bad sample changes nothing here, and a
link once lost must prove itself again. Limits depend on the state, for in contact a missing
telegram may be coasted over and a stop is not safe. Source: reference/reliability.md, 2.0, 4.
"""

from dataclasses import dataclass, replace
from typing import Annotated

from annotated_types import Ge, Gt, Le

from linemate.daemon.service.states import Link, Machine, Signals, State

Positive = Annotated[float, Gt(0.0)]
Count = Annotated[int, Ge(1), Le(100_000)]

IN_CONTACT = frozenset({State.CONTACT, State.RETREAT})


@dataclass(frozen=True, slots=True)
class WatchSettings:
    """When something counts as lost, stale, healthy or too long.

    Attributes:
        link_lost_s: without a telegram for this long the robot link is lost [s].
        healthy_cycles: answered in a row before a new link is trusted.
        missed: missed in a row that make the link doubtful.
        missed_in_contact: the same in contact.
        leak_limit: level of the leaky bucket (+2 a missed cycle, -1 a good one) that does too.
        position_s: age of the newest position beyond which tracking stops [s].
        position_in_contact_s: the same in contact, which is coasted on the prediction [s].
        one_sensor_s: age of the older of distance and camera beyond which tracking stops [s]; in
            contact the force-torque sensor stands in for them.
        wrench_s: age of the newest force [s].
        cycles_of_contact: in a row, before contact counts.
        cycles_of_overload: in a row, before overload counts; one is two samples in a row.
        near_m: a stop that leaves less to the object, which moves and swings, is a retreat [m].
        follow_s: the robot is at most so long behind its commands [s].
        follow_tolerance: and so far beside where they led it in that time [rad, m].
        cycles_astray: in a row beyond that, before it counts as a fault: the drives are off.
        longest_hold_s: [s].
        longest_retreat_s: [s].
    """

    link_lost_s: Positive = 0.1
    healthy_cycles: Count = 80
    missed: Count = 3
    missed_in_contact: Count = 12
    leak_limit: Count = 10
    position_s: Positive = 0.3
    position_in_contact_s: Positive = 0.14
    one_sensor_s: Positive = 1.0
    wrench_s: Positive = 0.1
    cycles_of_contact: Count = 2
    cycles_of_overload: Count = 1
    near_m: Positive = 0.03
    follow_s: Positive = 0.25
    follow_tolerance: Positive = 0.01
    cycles_astray: Count = 5
    longest_hold_s: Positive = 60.0
    longest_retreat_s: Positive = 20.0


@dataclass(frozen=True, slots=True)
class Facts:
    """What one cycle showed, as it was.

    Attributes:
        stamp_ns: of the cycle [ns].
        telegram: the cycle has a telegram.
        new_session: the controller has started anew.
        position_ns: arrival of the newest accepted position, distance or camera [ns], or None.
        slower_ns: the same of that sensor of the two whose newest is older [ns]; None while the
            task waits, for the object may be out of the camera's sight.
        wrench_ns: arrival of the newest force [ns], or None.
        wrench_expected: there is a force-torque sensor.
        gap_m: that a stop would leave between tool and object [m]; None while it is not seen.
        astray: the robot is not where its commands led it.
        ready, object_left, contact, overload, done, clear, fault: as in ``Signals``, raw.
        orders: accepted orders that came since the last cycle.
    """

    stamp_ns: int
    telegram: bool
    new_session: bool = False
    position_ns: int | None = None
    slower_ns: int | None = None
    wrench_ns: int | None = None
    wrench_expected: bool = True
    gap_m: float | None = None
    astray: bool = False
    ready: bool = False
    object_left: bool = False
    contact: bool = False
    overload: bool = False
    done: bool = False
    clear: bool = False
    fault: bool = False
    orders: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Watch:
    """What must be remembered from cycle to cycle.

    Attributes:
        link: the verdict on the robot link.
        telegram_ns: stamp of the last cycle with a telegram [ns], or None.
        good: cycles with a telegram, in a row since the link came.
        missed: cycles without one, in a row.
        leak: level of the leaky bucket.
        contact, overload, astray: cycles in a row that showed it.
        state: the operating state as last seen.
        since_ns: when it was entered [ns].
    """

    link: Link = Link.LOST
    telegram_ns: int | None = None
    good: int = 0
    missed: int = 0
    leak: int = 0
    contact: int = 0
    overload: int = 0
    astray: int = 0
    state: State = State.INIT
    since_ns: int = 0


def observe(
    watch: Watch, facts: Facts, machine: Machine, settings: WatchSettings
) -> tuple[Watch, Signals]:
    """Judge one cycle.

    Args:
        watch: what was remembered.
        facts: what the cycle showed.
        machine: where the state machine stands before this cycle.
        settings: the limits.

    Returns:
        What to remember, and the signals for ``states.transition``.
    """
    watch = _count(watch, facts, machine.state, settings)
    watch = replace(watch, link=_judge_link(watch, facts, machine.state, settings))
    return watch, _signals(watch, facts, settings)


def _count(watch: Watch, facts: Facts, state: State, settings: WatchSettings) -> Watch:
    # A link that was lost, or a controller that started anew, has proved nothing yet.
    anew = facts.new_session or watch.link is Link.LOST
    leak = 0 if anew else watch.leak + (-1 if facts.telegram else 2)
    return Watch(
        link=watch.link,
        telegram_ns=facts.stamp_ns if facts.telegram else watch.telegram_ns,
        good=(0 if anew else watch.good) + 1 if facts.telegram else 0,
        missed=0 if facts.telegram else watch.missed + 1,
        leak=max(0, min(leak, settings.leak_limit)),
        contact=watch.contact + 1 if facts.contact else 0,
        overload=watch.overload + 1 if facts.overload else 0,
        astray=watch.astray + 1 if facts.astray else 0,
        state=state,
        since_ns=watch.since_ns if state is watch.state else facts.stamp_ns,
    )


def _judge_link(watch: Watch, facts: Facts, state: State, settings: WatchSettings) -> Link:
    if facts.new_session and watch.link is not Link.LOST:
        return Link.LOST
    if _age_s(watch.telegram_ns, facts.stamp_ns) >= settings.link_lost_s:
        return Link.LOST
    if watch.link is Link.HEALTHY:
        return Link.UNPROVEN if _shaky(watch, state, settings) else Link.HEALTHY
    if watch.link is Link.UNPROVEN and watch.good >= settings.healthy_cycles:
        return Link.HEALTHY
    return Link.UNPROVEN


def _shaky(watch: Watch, state: State, settings: WatchSettings) -> bool:
    if state in IN_CONTACT:
        return watch.missed >= settings.missed_in_contact
    return watch.missed >= settings.missed or watch.leak >= settings.leak_limit


def _signals(watch: Watch, facts: Facts, settings: WatchSettings) -> Signals:
    stamp_ns = facts.stamp_ns
    coasting = watch.state in IN_CONTACT
    oldest_s = settings.position_in_contact_s if coasting else settings.position_s
    both = coasting or facts.slower_ns is None
    both = both or _age_s(facts.slower_ns, stamp_ns) <= settings.one_sensor_s
    position_fresh = _age_s(facts.position_ns, stamp_ns) <= oldest_s and both
    wrench_fresh = _age_s(facts.wrench_ns, stamp_ns) <= settings.wrench_s
    wrench_fresh = wrench_fresh or not facts.wrench_expected
    fault = facts.fault or watch.astray >= settings.cycles_astray
    trouble = fault or "stop" in facts.orders or watch.link is not Link.HEALTHY
    trouble = trouble or not (position_fresh and wrench_fresh)
    near = facts.gap_m is not None and facts.gap_m < settings.near_m
    return Signals(
        link=watch.link,
        position_fresh=position_fresh,
        wrench_fresh=wrench_fresh,
        ready=facts.ready,
        object_left=facts.object_left,
        # Whoever has to stop this near is as good as in contact.
        contact=watch.contact >= settings.cycles_of_contact or (near and trouble),
        overload=watch.overload >= settings.cycles_of_overload,
        done=facts.done,
        clear=facts.clear,
        expired=_expired(watch, stamp_ns, settings),
        fault=fault,
        arm="arm" in facts.orders,
        start="start" in facts.orders,
        stop="stop" in facts.orders,
        retreat="retreat" in facts.orders,
        ack="ack" in facts.orders,
    )


def _expired(watch: Watch, stamp_ns: int, settings: WatchSettings) -> bool:
    longest_s = {
        State.HOLD: settings.longest_hold_s,
        State.RETREAT: settings.longest_retreat_s,
    }.get(watch.state)
    return longest_s is not None and _age_s(watch.since_ns, stamp_ns) > longest_s


def _age_s(then_ns: int | None, now_ns: int) -> float:
    return float("inf") if then_ns is None else (now_ns - then_ns) / 1e9
