"""The process around the cycle: links in, replies out, and everything else afterwards.

Law of this file: it wires and decides nothing about the robot; that is the cycle's. From a
telegram to its reply there is no await, no log and no file. Recording, operators, status and the
collector come after the reply, each with a budget; what fails there costs itself and no reply.
"""

import asyncio
import contextlib
import logging
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.key_file import key_path, read_keys
from linemate.daemon.config.section_checks import group_ids
from linemate.daemon.config.settings import Corrections
from linemate.daemon.core.control.adaptation import ServoEstimates
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle import learning, states
from linemate.daemon.cycle.clock.phase_lock import Due, DueKind, PhaseLock
from linemate.daemon.cycle.clock.timer import CycleTimer
from linemate.daemon.cycle.clock.timing import Timing
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.learning import Learner
from linemate.daemon.cycle.states import State
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.recording import viewer_messages
from linemate.daemon.recording.format import STATE_LOG
from linemate.daemon.recording.recorder import MIB, Recorder, Rotation
from linemate.daemon.service import realtime
from linemate.daemon.service.account import Account
from linemate.daemon.service.command_server import CommandPort, CommandPortError, LocalDoor, UdpDoor
from linemate.daemon.service.incidents import IncidentFiles
from linemate.daemon.service.journal import Journal, Sensors
from linemate.daemon.service.notify import Notifier
from linemate.daemon.service.order_answers import Answers
from linemate.daemon.service.outlook import Outlook
from linemate.daemon.service.parameter_desk import Answer, Desk
from linemate.daemon.service.status import LinkView, Rates, Snapshot, covered, status, telemetry
from linemate.drivers import port_holder
from linemate.drivers.camera_peer import parse_peer
from linemate.drivers.camera_udp import CameraLink
from linemate.drivers.can_bus import CanLink
from linemate.drivers.datagrams import Address
from linemate.drivers.link import NOT_OPENED
from linemate.drivers.rsi_udp import RsiLink
from linemate.drivers.serial_port import SerialLink
from linemate.protocol.exchange import TelegramKind as Telegram
from linemate.protocol.rsi.codec import RsiCodec
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder
from linemate.protocol.sensors.wrench import BAUD_RATES, make_decoder, make_host

ORDERS = frozenset({"arm", "start", "stop", "retreat", "ack"})
REST_PATIENCE_S = 4.0
STATUS_EVERY_NS = 1_000_000_000
PATIENCE_NS = 1_000_000
"""How long beyond its time the loop waits for a telegram whose reply is ready [ns]."""

GUEST_NS = 1_000_000
"""So long before the next step is made or its telegram comes, operators wait for its end [ns]."""

SAY_EVERY = 1000
"""A fault of the cycle is logged once in so many."""

STATE_LINES = 4
"""Lines of state changes in the journal in any second."""

SENSORS_EVERY_NS = 20_000_000
"""Between two looks at which sensors came and went [ns]."""

DEVICE_LINES = 3
"""Lines of links and sensors in the journal in any second."""

log = logging.getLogger(__name__)
state_log = logging.getLogger("linemate.state")
device_log = logging.getLogger("linemate.device")

Link = RsiLink | CanLink | CameraLink | SerialLink
Handler = Callable[[Mapping[str, Any], str], Answer | asyncio.Future[Answer]]


class StartError(Exception):
    """The daemon cannot run; the message says why."""


class App:
    """One daemon.

    Args:
        host: what the host granted.

    Attributes:
        counters: what went wrong around it, by name.
    """

    def __init__(
        self,
        station: LoadedConfig,
        parameters: Parameters,
        host: realtime.Host,
        notifier: Notifier,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._station = station
        self._host = host
        self._notifier = notifier
        config = station.config
        self.cycle = Cycle(
            parameters,
            RsiCodec(station.rsi, config.rsi.linear_axes, constants=config.rsi.constants),
            config.watch,
            absolute=config.rsi.corrections is Corrections.ABSOLUTE,
            wrench_expected=config.force_torque is not None,
        )
        self._robot = RsiLink(
            self._on_telegram,
            config.rsi.bind,
            station.rsi_port,
            ready_reply=lambda: self.cycle.ready_reply,
        )
        self._sensors = tuple(_sensors(station, self.cycle))
        self._links: tuple[Link, ...] = (self._robot, *self._sensors)
        self._rates = Rates()
        self._commands = _command_port(station, self._handle, self._telemetry)
        self._recorder = _recorder(station)
        self._learner = _learner(station, parameters.cycle_s)
        self._outlook = Outlook(round(parameters.cycle_s * 1e3, 6))
        self._scene = viewer_messages.scene(station.texts, parameters.cycle_s)
        period_ns = round(parameters.cycle_s * 1e9)
        lead_ms = config.realtime.lead_ms
        lead_ns = None if lead_ms is None else round(lead_ms * 1e6)
        self._timer = CycleTimer(
            self._on_due,
            self._failed,
            self._look,
            PhaseLock(period_ns, time.monotonic_ns(), lead_ns),
            attend=self._attend,
        )
        self.cycle.date = self._date
        self._collector = realtime.Collector()
        self._companions = realtime.Companions(realtime.is_fifo())
        self._account = Account(Timing(period_ns))
        self._incidents = IncidentFiles(_folder(station, config.realtime.incidents))
        self._arrival: int | None = None
        self._began_ns = time.monotonic_ns()
        self._told_ns = 0
        self._telegram_ns: int | None = None
        self._after_waits = False
        # The last telegram met a fault of our own, then: a daemon that goes on so is not alive.
        self._failing_ns: int | None = None
        self._command: tuple[float, ...] = ()
        self._resting = 0
        self._links_up: dict[str, bool | None] = {}
        self._answers = Answers(self.cycle.operating, parameters.cycle_s)
        self._state_journal = Journal(state_log.info, STATE_LINES)
        self._device_journal = Journal(device_log.info, DEVICE_LINES)
        self._sensors_seen = Sensors()
        self._sensors_told_ns = 0
        self._cycled = asyncio.Event()
        self._end: asyncio.Event | None = None
        self._desk = Desk(station, self.cycle, self._explain, self._say)
        self._operations: dict[str, Handler] = {
            "status": lambda _params, _who: self.status(),
            "params": lambda params, _who: self._desk.describe(params),
            "get": lambda params, _who: self._desk.get(params),
            "record": lambda params, _who: self._record(params["action"]),
            "set": lambda params, who: self._desk.set(params["values"], who),
            "save": lambda _params, who: self._desk.save(who),
            "scene": lambda _params, _who: self._scene,
        }

    # The life of the process.

    async def run(self, on_ready: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
        """Open everything, serve until told to end, come to rest, close everything.

        Args:
            on_ready: told where the daemon listens once it does.

        Raises:
            StartError: a port that the daemon cannot do without is taken.
        """
        loop = asyncio.get_running_loop()
        self._end = asyncio.Event()
        try:
            self._open()
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.add_signal_handler(number, self._end.set)
            loop.add_signal_handler(signal.SIGHUP, self._reload)
            on_ready(self.listening())
            self._notifier.ready(self._line())
            log.info("ready: %s", self.listening())
            await self._end.wait()
            self._notifier.stopping()
            await self._come_to_rest()
        finally:
            await self._close()

    def end(self) -> None:
        """End as by SIGTERM."""
        if self._end is not None:
            self._end.set()

    def _open(self) -> None:
        self._robot.open()
        if self._robot.address is None:
            why = self._robot.status.reason + port_holder.told(
                self._robot.refusal, self._station.rsi_port
            )
            raise StartError(f"the robot's port cannot be opened: {why}")
        try:
            self._commands.open()
        except CommandPortError as error:
            raise StartError(str(error)) from error
        for link in self._sensors:
            link.open()
        recording = self._station.config.recording
        if recording is not None and self._recorder is not None:
            reason = self._recorder.start() if recording.at_start else self._recorder.open()
            if reason is not None:
                log.error("not recording: %s", reason)
        if self._station.config.realtime.freeze_collector:
            # A last full collection takes some 50 ms: before the clock runs.
            self._collector.freeze()
        self._timer.open()

    async def _close(self) -> None:
        self._timer.close()
        self._commands.close()
        for link in self._links:
            link.close()
        for link in self._links:
            await link.wait_closed()
        if self._recorder is not None:
            self._recorder.record(self.cycle.take_log())
            await asyncio.to_thread(self._recorder.close)
        self._host.close()
        self._collector.thaw()

    async def _come_to_rest(self) -> None:
        """Hold in free space, retreat from contact, and wait for the robot to stand."""
        if self.cycle.machine.state in states.MOVING:
            log.info("ending: the robot is brought to rest first")
            self.cycle.order("stop", "the end of the daemon")
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(REST_PATIENCE_S):
                while not self._at_rest():
                    self._cycled.clear()
                    await self._cycled.wait()
        if not self._at_rest():
            log.warning("ending although the robot moves: %s", self.cycle.machine.state)

    def _at_rest(self) -> bool:
        state = self.cycle.machine.state
        if state is State.HOLD:
            return self._resting >= 2
        return state not in states.MOVING

    def _reload(self) -> None:
        """SIGHUP: take the keys anew; sessions of keys that are gone end."""
        self._notifier.reloading()
        udp = self._station.config.command.udp
        if udp is not None:
            try:
                keys = read_keys(key_path(udp.keys, self._station.path.parent))
            except (UnreadableError, ValueError) as error:
                log.error("keys are not reloaded: %s", error)  # noqa: TRY400 - an operator's line
            else:
                self._commands.replace_keys(keys)
                log.info("keys reloaded: %d", len(keys))
        self._notifier.ready(self._line())

    # The cycle.

    def _on_telegram(
        self, data: bytes, stamp_ns: int, source: Address, *, is_answered: bool
    ) -> bytes | None:
        peer = self._station.config.rsi.peer
        if peer is not None and source[0] != peer:
            self.counters["foreign_telegrams"] += 1
            return None
        began_ns = time.monotonic_ns()
        prepared = self.cycle.prepared
        self.cycle.listen(self._robot.opened_ns)
        try:
            reply = self.cycle.on_telegram(data, stamp_ns, source, is_answered=is_answered)
        except Exception as error:  # noqa: BLE001 - an unanswered telegram stops the robot
            self._failing_ns = stamp_ns
            self._failed(error)
            return None
        if reply is None:
            return None
        self._failing_ns = None
        if self.cycle.prepared == prepared:
            self._account.stepped(time.monotonic_ns() - began_ns)
        self._telegram_ns = stamp_ns
        self._arrival = stamp_ns
        self._later()
        return reply

    def _attend(self, expected_ns: int) -> None:
        """Sleep until the expected telegram comes; nothing else is to be done before it."""
        if self.cycle.ready_reply is not None:
            patience_ns = min(PATIENCE_NS, self._timer.lock.period_ns // 4)
            self._robot.attend(expected_ns + patience_ns)

    def _look(self) -> None:
        """Answer telegrams that wait, so that none is called missing that is there already."""
        self._robot.poll()
        self._follow()

    def _date(self, stamp_ns: int, cycles: int) -> int:
        """Return when the controller's cycle began whose telegram has come [ns]."""
        if self._arrival is not None:
            return stamp_ns  # the clock has not followed the telegram before yet
        return self._timer.lock.date(stamp_ns, cycles)

    def _follow(self) -> None:
        """Let the clock follow the telegram that was answered; after the reply, it takes time."""
        stamp_ns, self._arrival = self._arrival, None
        decision = self.cycle.decision
        if stamp_ns is None or decision is None:
            return
        self._account.expected(self._timer.lock)
        lock = self._timer.lock
        restarts = decision.kind in {Telegram.FIRST, Telegram.NEW_SESSION}
        lock.follow(stamp_ns, decision.missed + 1, restarts=restarts)
        self._timer.arm()
        self.cycle.operating.wrong_cycle = lock.estimate.lasting_refusal

    def _on_due(self, due: Due) -> None:
        if due.kind is DueKind.PREPARE:
            began_ns = time.monotonic_ns()
            if self.cycle.prepare(due.stamp_ns):
                late_ns = self._timer.lateness.last_ns
                self._account.prepared(late_ns, time.monotonic_ns() - began_ns)
            return
        lost_s = self._station.config.watch.link_lost_s
        if self._telegram_ns is None or due.stamp_ns - self._telegram_ns > lost_s * 1e9:
            self._timer.lock.run_free()
            if self._failing_ns is not None and due.stamp_ns - self._failing_ns > lost_s * 1e9:
                self._failing_ns = None
        elif self._timer.lock.is_locked:
            self._account.missing(due.stamp_ns)
        self._account.expected(self._timer.lock)
        self.cycle.on_missing(due.stamp_ns)
        self._later()

    def _later(self) -> None:
        """Do the rest in the loop's next turn: the link sends the reply in this one."""
        if not self._after_waits:
            self._after_waits = True
            asyncio.get_running_loop().call_soon(self._after)

    def _after(self) -> None:
        self._after_waits = False
        try:
            self._follow()
            self._tell()
        except Exception as error:  # noqa: BLE001 - what fails here costs no reply
            self._failed(error)

    def _tell(self) -> None:
        now_ns = time.monotonic_ns()
        entries = self.cycle.take_log()
        for entry in entries:
            same = entry.outputs.command == self._command
            self._resting = self._resting + 1 if same else 0
            self._command = entry.outputs.command
        self._cycled.set()
        self._tell_changes(now_ns)
        self._answers.keep()
        times = self._account.close(entries, self._robot.turnaround_ns)
        incident = self._account.take_incident()
        if incident is not None:
            self._incidents.take(incident)
        self._incidents.slack()
        if self._recorder is not None:
            self._recorder.record(entries, times)
        self._outlook.take(entries, times)
        if self._learner is not None:
            self._learn(self._learner, entries)
        self._attend_operators()
        if self._failing_ns is None:
            self._notifier.alive(now_ns)
        if now_ns - self._told_ns >= STATUS_EVERY_NS:
            self._told_ns = now_ns
            self._companions.look()
            if self._recorder is not None:
                self._recorder.restart_writer_if_lost(now_ns)
            self._rates.take((link.status for link in self._links), now_ns)
            self._tell_links(now_ns)
            if self._notifier.address:
                self._notifier.send(f"STATUS={self._line()}")
        moving = bool(entries) and entries[-1].inputs.order is not MotionOrder.HOLD
        self._collector.slack(moving=moving)

    def _learn(self, learner: Learner, entries: Sequence[LogEntry]) -> None:
        """Note what moved; once the robot stands, look at it and hand on what was learned."""
        learner.take(entries)
        if not (learner.ripe and self.cycle.stands):
            return
        work = asyncio.get_running_loop().run_in_executor(None, learner.look, learner.motion())

        def done(finished: asyncio.Future[ServoEstimates]) -> None:
            if finished.cancelled():
                return
            error = finished.exception()
            if error is not None:
                log.error("nothing was learned of the servos: %s", error)
                return
            values = learner.keep(finished.result(), self._desk.settings.control.servos)
            answer = self._desk.set(values, learning.WHO) if values else {}
            if isinstance(answer, dict) and "refused" in answer:
                self._say(f"what was learned of the servos is not taken: {answer['refused']}")

        work.add_done_callback(done)

    def _attend_operators(self) -> None:
        """Handle what operators sent; until the next step is due also what they send yet."""
        budget = self._station.config.command.budget
        self._commands.poll(budget)
        lock = self._timer.lock
        if lock.is_locked:
            until_ns = lock.next_ns - lock.lead_ns - GUEST_NS
        else:
            # Without a robot there is nobody whom operators could hold up.
            until_ns = time.monotonic_ns() + lock.period_ns
        self._commands.invite(asyncio.get_running_loop(), until_ns, budget)

    def _tell_changes(self, now_ns: int) -> None:
        """Write why the state changed, and which sensors came and went."""
        for change in self.cycle.take_changes():
            self._state_journal.say(now_ns, str(change))
            self._say(str(change), change.stamp_ns, STATE_LOG)
        if now_ns - self._sensors_told_ns < SENSORS_EVERY_NS:
            return
        self._sensors_told_ns = now_ns
        sensors, hidden = self.cycle.samples.facts(), covered(self.cycle)
        came = self._sensors_seen.changes(now_ns, sensors, self._limits_s(), hidden)
        if came:
            self._tell_devices(now_ns, came)
        self._state_journal.catch_up(now_ns)
        self._device_journal.catch_up(now_ns)

    def _limits_s(self) -> dict[str, float]:
        """Return the age at which each sensor counts as silent [s]."""
        settings = self.cycle.operating.settings
        position_s = settings.position_s
        return {"distance": position_s, "camera": position_s, "force_torque": settings.wrench_s}

    def _tell_links(self, now_ns: int) -> None:
        """Write which links came and went."""
        lines = []
        for link in self._links:
            name, up = link.status.name, link.status.up
            was_up = self._links_up.setdefault(name, None)
            if was_up is None and not up and link.status.reason == NOT_OPENED:
                continue  # It is being opened.
            if was_up != up:
                self._links_up[name] = up
                reason = "" if up else f": {link.status.reason}"
                lines.append(f"link {name} is {'up' if up else 'down'}{reason}")
        if lines:
            self._tell_devices(now_ns, lines)

    def _tell_devices(self, now_ns: int, lines: list[str]) -> None:
        """Write what came and went at one time: one line in the journal, each in the recording."""
        self._device_journal.say(now_ns, "; ".join(lines))
        for text in lines:
            self._say(text, now_ns)

    def _say(self, text: str, stamp_ns: int | None = None, name: str = "linemated") -> None:
        at_ns = time.monotonic_ns() if stamp_ns is None else stamp_ns
        self._outlook.say(at_ns, text)
        if self._recorder is not None:
            self._recorder.write_line(at_ns, text, name=name)

    def _explain(self, parameters: Parameters, who: str, changed: Mapping[str, Any]) -> None:
        if self._recorder is not None:
            self._recorder.note_change(parameters, who, changed)

    def _failed(self, error: Exception) -> None:
        """Count a fault of our own; the log must not drown in it."""
        count = self.counters["faults"]
        self.counters["faults"] += 1
        if count % SAY_EVERY == 0:
            log.error("fault %d in the cycle", count + 1, exc_info=error)

    # Operators.

    def _handle(
        self, op: str, params: dict[str, Any], role: str, who: str
    ) -> Answer | asyncio.Future[Answer]:
        del role  # judged by the protocol
        if op in ORDERS:
            reason = self._wrong_period() if op == "arm" else None
            reason = reason or self.cycle.order(op, who)
            outcome = f", refused: {reason}" if reason else ""
            self._say(f"{who} ordered {op}{outcome}")
            return self._answers.promise(op) if reason is None else {"refused": reason}
        handler = self._operations.get(op)
        return {"refused": f"no such operation: {op}"} if handler is None else handler(params, who)

    def _wrong_period(self) -> str | None:
        """Return why the controller's period forbids to arm, None if it does not.

        What else forbids it is told before a period that is not measured yet.
        """
        estimate = self._timer.lock.estimate
        is_idle = self.cycle.machine.state is State.IDLE
        return estimate.arm_refusal if is_idle else estimate.refusal

    def _record(self, action: str) -> dict[str, Any]:
        if self._recorder is None:
            return {"refused": "the configuration names no directory for recordings"}
        reason = self._recorder.start() if action == "start" else self._recorder.stop()
        self._links_up.clear()
        if reason is None and action == "start":
            self._say(f"{self.cycle.machine.state}: {self.cycle.operating.cause}")
        return {"refused": reason} if reason else {"file": self._recorder.status.file}

    def status(self) -> dict[str, Any]:
        """What an operator wants to know; plain values."""
        return status(self._snapshot())

    def _telemetry(self) -> dict[str, Any]:
        nominal = self.cycle.parameters.tracker.reference.nominal
        return telemetry(self.cycle) | self._outlook.shown(nominal)

    def _snapshot(self) -> Snapshot:
        links = [
            LinkView(link.status, getattr(link, "address", None), self._rates.of(link.status.name))
            for link in self._links
        ]
        return Snapshot(
            task=self._station.task.file.name,
            now_ns=time.monotonic_ns(),
            began_ns=self._began_ns,
            cycle=self.cycle,
            links=tuple(links),
            timer=self._timer,
            timing=self._account.timing,
            recorder=None if self._recorder is None else self._recorder.status,
            commands=self._commands.status(),
            refusals=self._host.refusals(),
            counters=self.counters,
        )

    def _line(self) -> str:
        machine = self.cycle.machine
        return f"{machine.state.upper()} ({machine.because}), {self.cycle.steps} steps"

    def listening(self) -> dict[str, Any]:
        """Where the daemon listens, ports that the system chose among them."""
        command = self._station.config.command
        camera = [link.address for link in self._sensors if isinstance(link, CameraLink)]
        socket = command.socket and str(self._station.path.parent / command.socket)
        return {
            "pid": os.getpid(),
            "robot": self._robot.address,
            "camera": camera[0] if camera else None,
            "command": {"socket": socket, "udp": self._commands.udp_address},
        }


def _sensors(station: LoadedConfig, cycle: Cycle) -> Iterator[CanLink | CameraLink | SerialLink]:
    config = station.config
    if config.distance is not None and station.dbc is not None:
        distance = config.distance
        decoder = DistanceDecoder(
            station.dbc,
            distance.message,
            distance.signal,
            strength=distance.strength,
            can_id=distance.can_id,
            step=distance.step_m,
        )
        yield CanLink(distance.can, decoder, cycle.samples.distance.push)
    if config.camera is not None:
        camera = config.camera
        poses = CameraDecoder(camera.frame, camera.object, camera.source)
        peer = None if camera.peer is None else parse_peer(camera.peer)
        yield CameraLink(poses, cycle.samples.camera.push, camera.bind, camera.port, peer=peer)
    if config.force_torque is not None:
        wrench = config.force_torque
        yield SerialLink(
            wrench.url,
            make_decoder(wrench.device),
            cycle.samples.wrench.push,
            baudrate=wrench.baudrate or BAUD_RATES[wrench.device],
            host=partial(make_host, wrench.device) if wrench.dialogue else None,
        )


def _command_port(
    station: LoadedConfig,
    handle: Callable[[str, dict[str, Any], str, str], Answer | asyncio.Future[Answer]],
    snapshot: Callable[[], Mapping[str, Any]],
) -> CommandPort:
    command = station.config.command
    local = udp = None
    if command.socket is not None:
        operators = command.operate_groups
        local = LocalDoor(
            station.path.parent / command.socket,
            operate_gids=None if operators is None else group_ids(operators),
            view_gids=group_ids(command.view_groups),
        )
    if command.udp is not None:
        door = command.udp
        udp = UdpDoor(door.bind, door.port, station.keys, door.allow_remote)
    return CommandPort(handle, snapshot, local, udp)


def _folder(station: LoadedConfig, name: str | None) -> Path | None:
    return None if name is None else Path(station.path.parent / name)


def _learner(station: LoadedConfig, cycle_s: float) -> Learner | None:
    """Return what learns the servos anew, None where that is not wanted."""
    settings = station.config.learning
    if settings is None:
        return None
    axes = 7 if station.task.file.arm.linear_axis else 6
    return Learner(settings, station.written.control.servos[:axes], cycle_s)


def _recorder(station: LoadedConfig) -> Recorder | None:
    settings = station.config.recording
    if settings is None:
        return None
    directory = station.path.parent / settings.directory
    return Recorder(
        Path(directory),
        dict(station.texts),
        settings.queue,
        settings.chunk_kib * 1024,
        settings.flush_s,
        Rotation(
            settings.rotate_mib * MIB,
            settings.rotate_min * 60.0,
            None if settings.total_mib is None else settings.total_mib * MIB,
            settings.reserve_mib * MIB,
        ),
    )
