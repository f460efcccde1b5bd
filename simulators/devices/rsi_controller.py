"""Strict RSI controller: telegrams, judgement of replies, applied setpoints.

Invariants:
    Pure: bytes in and out, time is an argument.
    A reply counts if it is readable, in time, and has the SENTYPE and the open IPOC.
    Corrections are relative to the start pose and are clamped to the limits.
    A correction beyond the monitor's range stops the program.
    HOLDON says whether a missing value is held or zero.
"""

from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from operator import add
from typing import Literal

from msgspec import Struct

from linemate.protocol.exchange_controller import ControllerCounts, ControllerExchange, Judgement
from linemate.protocol.rsi.codec import (
    Channel,
    Element,
    RobotTelegram,
    RsiCodec,
    RsiConfig,
    RsiError,
    SensorTelegram,
)
from linemate.protocol.stamped_samples import Vector6
from linemate.simulators.devices.limit_judge import LIMITS, AxisLimit, LimitJudge

AXES = 7
EXTERNAL_AXES = 6
MESSAGES = 16
_JOINT_KEYS = tuple(f"A{n}" for n in range(1, 7))
_EXTERNAL_KEYS = tuple(f"E{n}" for n in range(1, EXTERNAL_AXES + 1))
_JOINT_ELEMENTS, _EXTERNAL_ELEMENTS = {"AK", "AKorr"}, {"EK", "EKorr"}
_UNUSED = (0.0,) * (EXTERNAL_AXES - 1)

Seven = tuple[float, float, float, float, float, float, float]
"""A1..A6 [rad] and E1 [m]."""


class RobotReading(Struct, frozen=True):
    """What the controller knows of its robot at a cycle's start.

    Attributes:
        axes: measured A1..A6 [rad], E1 [m].
        tcp: measured x, y, z [m], a, b, c [rad] in base.
        digital_in: signals of the tool.
    """

    axes: Seven
    tcp: Vector6
    digital_in: int = 0


@dataclass(frozen=True, slots=True)
class ControllerConfig:
    """How the controller is set up.

    Attributes:
        cycle_s: 0.012 or 0.004 [s].
        first_ipoc: counter of the first telegram [ms].
        timeout: cycles without a good answer that are tolerated.
        timeout_rule: whether they count as a running total or in a row; KUKA does not say.
        patient: cycles before the first good reply are not charged.
        mode: corrections are total offsets or increments.
        limits: of each axis, for the judge and, as software limits, for the corrections.
        correction_low: least total correction [rad, m]; None: down to the software limits.
        correction_high: greatest total correction [rad, m]; None: up to the software limits.
        monitor: greatest magnitude of the total correction before the robot is stopped
            [rad, m]; None: wider than the correction limits.
        decimals: digits after the point in the telegrams.
    """

    cycle_s: float = 0.012
    first_ipoc: int = 4_208_163_634
    timeout: int = 100
    timeout_rule: Literal["total", "row"] = "total"
    patient: bool = False
    mode: Literal["absolute", "relative"] = "absolute"
    limits: tuple[AxisLimit, ...] = LIMITS
    correction_low: Seven | None = None
    correction_high: Seven | None = None
    monitor: Seven | None = None
    decimals: int = 8

    @property
    def ipoc_step(self) -> int:
        """What the counter grows by each cycle [ms]."""
        return max(1, round(self.cycle_s * 1e3))

    @property
    def total_tolerated(self) -> int | None:
        """Cycles in all without a good answer that are tolerated; None if they count in a row."""
        return self.timeout if self.timeout_rule == "total" else None


class Applied(Struct, frozen=True):
    """What became of one cycle.

    Attributes:
        cycle: number of the cycle in this session, 0 for the first.
        setpoints: where the axes go during it, A1..A6 [rad], E1 [m].
        digital_out: signals to the tool.
        outcome: what became of its reply; None after the exchange broke off.
        clamped: a correction limit held something back.
        motion: where the controller's own filter sends the axes; None: to the setpoints.
    """

    cycle: int
    ipoc: int
    setpoints: Seven
    digital_out: int
    outcome: Judgement | None
    clamped: bool
    motion: Seven | None = None

    @property
    def answered(self) -> bool:
        """The cycle got a good reply."""
        return self.outcome is Judgement.ACCEPTED


@dataclass(frozen=True, slots=True)
class _Receive:
    """One receive element.

    Attributes:
        holdon: its value is held while none comes.
        place: where a reply has it: A1..A6, then E1..E6; None if it is one of the channels.
        axis: which of the seven it corrects, None if it is no correction.
    """

    tag: str
    holdon: bool
    place: int | None
    axis: int | None


@dataclass(slots=True)
class _Session:
    """What is forgotten when the operator starts the programme again."""

    start: Seven
    external_start: Vector6
    low: Seven
    high: Seven
    total: list[float]
    held: list[Channel | None]
    tcp: Vector6 | None = None
    cycle: int = -1
    ipoc: int = 0
    reply: SensorTelegram | None = None
    stopped: str | None = None


class RsiController:
    """The controller's side of RSI, with a robot that stands still in RSI_MOVECORR.

    Example::

        data = controller.telegram()                 # at t_k
        controller.on_reply(reply, stamp_ns, deadline_ns)
        applied = controller.end_of_cycle()          # active from t_k on

    Attributes:
        config: how it is set up.
        judge: the emulator's own view of the applied setpoints.
        refusals: replies refused, by reason.
        clamped: cycles in which a correction limit held something back.
        messages: the newest texts for the pendant.
    """

    def __init__(
        self,
        rsi: RsiConfig,
        read: Callable[[], RobotReading],
        setpoints: Seven,
        config: ControllerConfig | None = None,
    ) -> None:
        """Begin before the first cycle.

        Args:
            read: gives the robot's state at a cycle's start.
            setpoints: where the robot stands, A1..A6 [rad], E1 [m].
            config: how the controller is set up.

        Raises:
            RsiError: if the configuration makes no telegram.
            ValueError: if the time-out or its rule make no sense.
        """
        self.config = config = config or ControllerConfig()
        self.codec = RsiCodec(rsi, decimals=config.decimals)
        self.judge = LimitJudge(config.cycle_s, config.limits)
        self.refusals: Counter[str] = Counter()
        self.clamped = 0
        self.messages: deque[str] = deque(maxlen=MESSAGES)
        self._read = read
        receives = tuple(map(_receive, rsi.receive))
        self._plan = tuple((receive.tag, receive.place, receive.holdon) for receive in receives)
        self._corrections = tuple(
            (n, receive.axis) for n, receive in enumerate(receives) if receive.axis is not None
        )
        tags = [element.tag for element in rsi.receive]
        self._stop = tags.index("Stop") if "Stop" in tags else None
        self._signals = tags.index("DiO") if "DiO" in tags else None
        self._sends_signals = "DiL" in {element.tag for element in self.codec.config.send}
        self._setpoints = setpoints
        self._digital_out = 0
        self._ipoc_shift = 0
        self._exchange = ControllerExchange(
            config.ipoc_step,
            config.timeout,
            config.timeout_rule,
            first_counter=config.first_ipoc,
            patient=config.patient or rsi.onlysend,
        )
        self._session = self._new_session()

    @property
    def counts(self) -> ControllerCounts:
        """Telegrams sent, answered, late, lost and refused."""
        return self._exchange.counts

    @property
    def delay(self) -> int:
        """What the telegrams say in Delay."""
        return self._exchange.delay

    @property
    def setpoints(self) -> Seven:
        """Where the axes were sent last, A1..A6 [rad], E1 [m]."""
        return self._setpoints

    @property
    def broken(self) -> str | None:
        """Why the exchange ended, None while it goes on."""
        if self._session.stopped is not None:
            return self._session.stopped
        if self._exchange.broken:
            return "KSS29002 ETHERNET returns error RSITimeout"
        return None

    def restart(self, first_ipoc: int | None = None, setpoints: Seven | None = None) -> None:
        """Start the programme again: a new session from where the robot stands.

        Args:
            first_ipoc: its first counter; None: a second after the last one.
            setpoints: where that is, A1..A6 [rad], E1 [m]; None: where it was sent last.
        """
        if setpoints is not None:
            self._setpoints = setpoints
        last = self._session.ipoc
        self._exchange.restart(last + 1000 if first_ipoc is None else first_ipoc)
        self._session = self._new_session()
        self._ipoc_shift = 0

    def jump(self, cycles: int | None) -> None:
        """Let the counter of the telegrams jump; the programme and its corrections go on.

        Args:
            cycles: how far, None: to 0.
        """
        following = self._session.ipoc + self.config.ipoc_step
        self._ipoc_shift = (
            -following if cycles is None else (self._ipoc_shift + cycles * self.config.ipoc_step)
        )

    def begin(self) -> None:
        """Count and charge from the next cycle on, in the same session.

        What came before was only to see that somebody answers.
        """
        config = self.config
        following = self._session.ipoc + config.ipoc_step if self._session.cycle >= 0 else None
        self._exchange = ControllerExchange(
            config.ipoc_step,
            config.timeout,
            config.timeout_rule,
            first_counter=config.first_ipoc if following is None else following,
            patient=config.patient or self.codec.config.onlysend,
        )
        self._session.cycle = -1
        self.refusals.clear()

    def telegram(self) -> bytes | None:
        """Open a cycle.

        Returns:
            Its telegram; None once the exchange has ended.
        """
        session = self._session
        session.cycle += 1
        session.reply = None
        if self.broken is not None:
            return None
        session.ipoc = self._exchange.next_counter()
        ipoc = session.ipoc + self._ipoc_shift
        return self.codec.format_robot(self._describe(ipoc, self._read()))

    def on_reply(self, data: bytes, stamp_ns: int = 0, deadline_ns: int | None = None) -> Judgement:
        """Judge a reply.

        Args:
            deadline_ns: end of the open cycle [ns], None if the caller closes it in time.

        Returns:
            What the reply is.
        """
        try:
            reply = self.codec.parse_sensor(data)
        except RsiError:
            return self._refuse("malformed")
        if reply.sentype != self.codec.config.sentype:
            return self._refuse("sentype")
        ipoc = reply.ipoc - self._ipoc_shift
        judgement = self._exchange.on_reply(ipoc, stamp_ns, deadline_ns)
        if judgement is Judgement.ACCEPTED:
            self._session.reply = reply
        else:
            self.refusals[judgement.value] += 1
        return judgement

    def end_of_cycle(self) -> Applied:
        """Close the open cycle and apply what it brought.

        Returns:
            Where the axes go during it, and what became of it.
        """
        session = self._session
        ended = self.broken is not None
        outcome = None if ended else self._exchange.close_cycle()
        clamped = False
        if not ended and self.broken is None:
            clamped = self._apply(session)
        if outcome is Judgement.ACCEPTED and self.broken is None and _corrects(session.reply):
            self.judge.judge(self._setpoints)
        else:
            self.judge.hold(self._setpoints)
        self.clamped += clamped
        return Applied(
            session.cycle, session.ipoc, self._setpoints, self._digital_out, outcome, clamped
        )

    def _new_session(self) -> _Session:
        start, config = self._setpoints, self.config
        software = zip(config.limits, start, strict=True)
        low, high = zip(*((a.low - q, a.high - q) for a, q in software), strict=True)
        self.judge.start(start)
        return _Session(
            start=start,
            external_start=_six((start[6], *_UNUSED)),
            low=config.correction_low or low,
            high=config.correction_high or high,
            total=[0.0] * AXES,
            held=[None] * len(self._plan),
        )

    def _describe(self, ipoc: int, reading: RobotReading) -> RobotTelegram:
        """The telegram's values; setpoints are the programme's, without corrections."""
        session = self._session
        if session.tcp is None:
            session.tcp = reading.tcp
        a1, a2, a3, a4, a5, a6, e1 = reading.axes
        return RobotTelegram(
            ipoc,
            b"",
            (a1, a2, a3, a4, a5, a6),
            session.start[:6],
            (e1, 0.0, 0.0, 0.0, 0.0, 0.0),
            session.external_start,
            reading.tcp,
            session.tcp,
            self._exchange.delay,
            {"DiL": reading.digital_in} if self._sends_signals else {},
        )

    def _refuse(self, reason: str) -> Judgement:
        self.refusals[reason] += 1
        return self._exchange.on_unreadable()

    def _apply(self, session: _Session) -> bool:
        """Move the setpoints; return whether a limit held something back."""
        reply, held = session.reply, session.held
        if reply is not None and reply.message:
            self.messages.append(reply.message)
        axes, channels = _NOTHING if reply is None else _parts(reply)
        for n, (tag, place, holdon) in enumerate(self._plan):
            given = channels.get(tag) if place is None else axes[place]
            if given is not None or not holdon:
                held[n] = given
        if self._stop is not None and _is_set(held[self._stop]):
            session.stopped = "STOP object: the reply asked for it"
            return False
        self._digital_out = 0 if self._signals is None else int(held[self._signals] or 0)
        return self._correct(session)

    def _correct(self, session: _Session) -> bool:
        clamped = False
        total, held = session.total, session.held
        adds = self.config.mode == "relative"
        for n, axis in self._corrections:
            correction = float(held[n] or 0.0)
            if adds:
                correction += total[axis]
            low, high = session.low[axis], session.high[axis]
            if not low <= correction <= high:
                correction = min(max(correction, low), high)
                clamped = True
            total[axis] = correction
        if self.config.monitor is not None:
            self._watch(session, self.config.monitor)
        if session.stopped is None:
            a, b, c, d, e, f, g = map(add, session.start, total)
            self._setpoints = (a, b, c, d, e, f, g)
        return clamped

    @staticmethod
    def _watch(session: _Session, monitor: Seven) -> None:
        """The monitor object: too great a total correction stops the robot."""
        for axis, (total, most) in enumerate(zip(session.total, monitor, strict=True)):
            if abs(total) > most:
                name = f"A{axis + 1}" if axis < AXES - 1 else "E1"
                session.stopped = f"KSS29000 AXISCORRMON {name}: {total:g} exceeds {most:g}"
                return


_Axes = tuple[float | None, ...]
"""A1..A6 [rad], E1..E6 [m] or [rad]; None where there is no value."""

_NO_AXES: _Axes = (None,) * 6
_NOTHING: tuple[_Axes, Mapping[str, Channel]] = ((None,) * 12, {})


def _parts(reply: SensorTelegram) -> tuple[_Axes, Mapping[str, Channel]]:
    """What a reply brought, the axes by their place."""
    external = reply.external or ()
    return (*(reply.joints or _NO_AXES), *external, *_NO_AXES[len(external) :]), reply.channels


def _corrects(reply: SensorTelegram | None) -> bool:
    """Return whether a reply has corrections. Without, the controller holds by itself."""
    return reply is not None and (reply.joints is not None or reply.external is not None)


def _receive(element: Element) -> _Receive:
    """Resolve a receive element once: where a reply has its value, and what it corrects."""
    name, _, axis = element.tag.partition(".")
    if name in _JOINT_ELEMENTS and axis in _JOINT_KEYS:
        place = _JOINT_KEYS.index(axis)
        return _Receive(element.tag, element.holdon, place, place)
    if name in _EXTERNAL_ELEMENTS and axis in _EXTERNAL_KEYS:
        place = _EXTERNAL_KEYS.index(axis)
        return _Receive(element.tag, element.holdon, 6 + place, AXES - 1 if place == 0 else None)
    return _Receive(element.tag, element.holdon, None, None)


def _is_set(value: Channel | None) -> bool:
    return value is not None and not isinstance(value, str) and float(value) != 0.0


def _six(values: tuple[float, ...]) -> Vector6:
    a, b, c, d, e, f = values
    return (a, b, c, d, e, f)
