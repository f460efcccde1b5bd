"""The daemon's process around the cycle: links, operators, recording, status.

Invariants:
- Nothing about the robot is decided here; the cycle decides.
- From a telegram to its reply there is no await, no log and no file.
- Recording, operators, status and the garbage collector come after the reply, each with a budget.
  A failure there costs no reply.
"""

import asyncio
import contextlib
import logging
import os
import signal
import time
from collections import Counter
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.key_file import key_path, read_keys
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle import states, watch
from linemate.daemon.cycle.clock.phase_lock import Due, DueKind, PhaseLock
from linemate.daemon.cycle.clock.timer import CycleTimer
from linemate.daemon.cycle.clock.timing import Timing
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import State
from linemate.daemon.recording import viewer_messages
from linemate.daemon.service.assembly import (
    build_command_port,
    build_link,
    build_production,
    build_recorder,
    build_robot,
    build_sensors,
    incident_directory,
)
from linemate.daemon.service.cycle_timing import CycleTiming
from linemate.daemon.service.endpoints import CommandPortError
from linemate.daemon.service.event_log import EventLog
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.late_imports import LateImports
from linemate.daemon.service.host.notify import Notifier
from linemate.daemon.service.idle_rest import LOOK_NS, IdleRest
from linemate.daemon.service.incidents import IncidentFiles
from linemate.daemon.service.learning.learners import Learners
from linemate.daemon.service.live_telemetry import LiveTelemetry
from linemate.daemon.service.order_answers import Answers
from linemate.daemon.service.parameter_service import Answer, ParameterService
from linemate.daemon.service.production.production_cell import ProductionCell
from linemate.daemon.service.status import DaemonSnapshot, LinkView, Rates, status, telemetry
from linemate.drivers.datagrams import Address
from linemate.drivers.udp import port_holder
from linemate.drivers.udp.camera_udp import CameraLink
from linemate.drivers.udp.robot_udp import RobotLink
from linemate.protocol.exchange import TelegramKind as Telegram

if TYPE_CHECKING:
    from linemate.drivers.can_bus import CanLink
    from linemate.drivers.serial_port import SerialLink

    Link = RobotLink | CanLink | CameraLink | SerialLink

ORDERS = frozenset(watch.OPERATIONS)
LONGEST_CHUNK_S = 60.0  # between begin_ns and a target pose handed in [s]
REST_TIMEOUT_S = 4.0
STATUS_EVERY_NS = 1_000_000_000
# What is done once a second takes 20 us, with cold caches 100 us, of the time to the next step.
STATUS_NS = 200_000
WAIT_NS = 1_000_000  # longest wait for a late telegram whose reply is ready [ns]
WINDOW_MARGIN_NS = 1_000_000  # from the end of the operators' window to the next step [ns]

# Without a robot, or with one that stands idle, for so long and without a viewer, no steps are
# made [s].
REST_AFTER_S = 5.0
REST_S = 0.05  # between two wakes of the clock then [s]

LOG_EVERY = 1000  # a fault of the cycle is logged once in so many

log = logging.getLogger(__name__)

Handler = Callable[[Mapping[str, Any], str], Answer | asyncio.Future[Answer]]


class StartError(Exception):
    """The daemon cannot run; the message says why."""


class App:
    """One daemon.

    Args:
        variants: compiled tasks of the production's variants.

    Attributes:
        counters: faults and foreign telegrams.
    """

    def __init__(
        self,
        station: LoadedConfig,
        parameters: Parameters,
        host: realtime.RealtimeHost,
        notifier: Notifier,
        variants: Mapping[str, Parameters] | None = None,
    ) -> None:
        self.counters: Counter[str] = Counter()
        self._station = station
        self._host = host
        self._notifier = notifier
        config = station.config
        self.cycle = Cycle(
            parameters,
            build_link(station, parameters),
            config.watch,
            wrench_expected=config.force_torque is not None,
        )
        self._robot = build_robot(station, self._on_telegram, self.cycle)
        self._peer = station.robot.peer
        self._sensors = tuple(build_sensors(station, self.cycle))
        self._links: tuple[Link, ...] = (self._robot, *self._sensors)
        self._rates = Rates()
        self._commands = build_command_port(station, self._handle, self._telemetry)
        self._recorder = build_recorder(station)
        self._live = LiveTelemetry(round(parameters.cycle_s * 1e3, 6))
        self._scene = viewer_messages.scene(station.texts, parameters.cycle_s)
        period_ns = round(parameters.cycle_s * 1e9)
        self._timer = self._cycle_timer(period_ns)
        self.cycle.date = self._timer.lock.date
        self._collector = realtime.Collector()
        self._imports = LateImports()
        self._helpers = realtime.HelperThreads(realtime.is_fifo())
        self._times = CycleTiming(Timing(period_ns))
        self._incidents = IncidentFiles(incident_directory(station))
        self._began_ns = time.monotonic_ns()
        self._status_ns = 0
        self._telegram_ns: int | None = None
        self._after_waits = self._is_attending = False
        # Time of a fault at the last telegram: the watchdog is not fed then.
        self._failing_ns: int | None = None
        self._command: tuple[float, ...] = ()
        self._resting = 0
        self._answers = Answers(self.cycle.operating, parameters.cycle_s)
        self._events = EventLog(self.cycle, self._recorder, self._live)
        self._cycled = asyncio.Event()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._end: asyncio.Event | None = None
        self._production: ProductionCell | None = None
        self._make_services(variants or {})

    def _make_services(self, variants: Mapping[str, Parameters]) -> None:
        """Make what serves operators, learns, and brings part after part."""
        self._parameters = ParameterService(
            self._station, self.cycle, self._note_parameters, self._events.add
        )
        self._learners = Learners(
            self._station,
            self.cycle,
            self.cycle.parameters.cycle_s,
            lambda: self._parameters.settings,
            self._parameters.set,
            self._events.add,
        )
        self._production = build_production(
            self._station,
            self.cycle,
            variants,
            self._parameters,
            self._events,
            self._recorder,
            lambda op: self._period_refusal() if op == "arm" else None,
        )
        self._operations = self._own_operations()
        if self._production is not None:
            self._operations |= self._production.operations
        self._rest = IdleRest(
            self.cycle,
            self._timer,
            lambda: self._production is not None or self._commands.is_used,
            REST_AFTER_S,
        )

    def _cycle_timer(self, period_ns: int) -> CycleTimer:
        """Return the timer of the steps, with the lead of the configuration."""
        lead_ms = self._station.config.realtime.lead_ms
        lead_ns = None if lead_ms is None else round(lead_ms * 1e6)
        return CycleTimer(
            self._on_due,
            self._failed,
            self._answer_waiting,
            PhaseLock(period_ns, time.monotonic_ns(), lead_ns),
            attend=self._attend,
        )

    def _own_operations(self) -> dict[str, Handler]:
        """Return the operations of the command protocol but those of production."""
        return {
            "status": lambda _params, _who: self.status(),
            "params": lambda params, _who: self._parameters.describe(params),
            "get": lambda params, _who: self._parameters.get(params),
            "record": lambda params, _who: self._record(params["action"]),
            "follow": self._follow_poses,
            "set": lambda params, who: self._parameters.set(params["values"], who),
            "save": lambda _params, who: self._parameters.save(who),
            "scene": lambda _params, _who: self._scene,
            "sensors": lambda _params, _who: self._live.sensors(),
        }

    async def run(self, on_ready: Callable[[dict[str, Any]], None] = lambda _: None) -> None:
        """Open everything, serve until SIGTERM, bring the robot to rest, close everything.

        Args:
            on_ready: called with the addresses once the daemon listens.

        Raises:
            StartError: the robot's port or an endpoint cannot be opened.
        """
        # Kept: each get_running_loop is a system call.
        self._loop = loop = asyncio.get_running_loop()
        self._end = asyncio.Event()
        try:
            self._open()
            for number in (signal.SIGTERM, signal.SIGINT):
                loop.add_signal_handler(number, self._end.set)
            loop.add_signal_handler(signal.SIGHUP, self._reload)
            on_ready(self.listening())
            self._notifier.ready(self._line())
            log.info("ready: %s", self.listening())
            self._imports.watch()
            await self._end.wait()
            self._notifier.stopping()
            await self._come_to_rest()
            await self._robot.end_stream()
        finally:
            await self._close()

    def end(self) -> None:
        """End the daemon as SIGTERM does."""
        if self._end is not None:
            self._end.set()

    def _open(self) -> None:
        self._robot.open()
        if self._robot.address is None:
            why = self._robot.status.reason + port_holder.describe_holder(
                self._robot.refusal, self._station.robot.port
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
            self._collector.freeze()
        if self._station.config.realtime.lock_memory:
            realtime.use_huge_pages()
        self._timer.open()

    async def _close(self) -> None:
        self._imports.close()
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
            async with asyncio.timeout(REST_TIMEOUT_S):
                while not self._at_rest():
                    self._cycled.clear()
                    await self._cycled.wait()
        if not self._at_rest():
            log.warning("ending although the robot moves: %s", self.cycle.machine.state)

    def _at_rest(self) -> bool:
        state = self.cycle.machine.state
        if state in {State.HOLD, State.IDLE}:
            return self._resting >= 2
        return state not in states.MOVING

    def _reload(self) -> None:
        """Read the keys again (SIGHUP); sessions of removed keys end."""
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

    def _on_telegram(
        self, data: bytes, stamp_ns: int, source: Address, *, is_answered: bool
    ) -> bytes | None:
        if self._peer is not None and source[0] != self._peer:
            self.counters["foreign_telegrams"] += 1
            return None
        began_ns = time.monotonic_ns()
        lock = self._timer.lock
        is_due = lock.arrival_ns is not None and self.cycle.is_resting
        if is_due and not (is_answered and self._rest.is_between_looks(stamp_ns)):
            self._follow()  # the newest of those that waited for nothing
            is_due = False
        self.cycle.session.turnaround_ns = self._robot.turnaround_ns or 0
        prepared, decision = self.cycle.prepared, self.cycle.decision
        try:
            reply = self.cycle.on_telegram(data, stamp_ns, source, is_answered=is_answered)
        except Exception as error:  # noqa: BLE001 - an unanswered telegram stops the robot
            self._failing_ns = stamp_ns
            lock.unfollowed += self.cycle.decision is not decision
            self._failed(error)
            return None
        if reply is None:
            return None
        self._failing_ns = None
        lock.unfollowed += is_due
        self._telegram_ns = lock.arrival_ns = stamp_ns
        if self.cycle.prepared == prepared:
            if is_answered and self._rest.is_between_looks(stamp_ns):
                # Not even the clock: it follows at the next look, which saves a seventh of a rest.
                return reply
            if not self.cycle.is_resting:
                self._times.note_step(time.monotonic_ns() - began_ns)
        self._call_after_reply()
        return reply

    def _attend(self, expected_ns: int) -> None:
        """Sleep until the expected telegram comes; nothing else is to be done before it."""
        if self.cycle.ready_reply is None:
            return
        wait_ns = min(WAIT_NS, self._timer.lock.period_ns // 4)
        self._is_attending = True
        try:
            self._robot.attend(expected_ns + wait_ns)
        finally:
            self._is_attending = False
        if self._after_waits:
            # The link has sent the reply: a turn of the loop would cost 20 us.
            self._after()

    def _answer_waiting(self) -> None:
        """Answer telegrams that have come, so that none of them counts as missing."""
        self._robot.poll()
        self._follow()

    def _follow(self) -> None:
        """Let the clock follow the answered telegram, after the reply."""
        lock, decision = self._timer.lock, self.cycle.decision
        stamp_ns, lock.arrival_ns = lock.arrival_ns, None
        if stamp_ns is None or decision is None:
            return
        self._times.note_schedule(lock)
        restarts = decision.kind in {Telegram.FIRST, Telegram.NEW_SESSION}
        cycles, ahead = decision.missed + 1 + lock.unfollowed, self.cycle.exchange.ahead
        lock.follow(stamp_ns, cycles, ahead=ahead, restarts=restarts)
        lock.unfollowed = 0
        if not lock.is_slow:
            # Else the clock finds out when it wakes: each call costs 18 us.
            self._timer.arm()
        self.cycle.operating.wrong_cycle = lock.estimate.lasting_refusal

    def _on_due(self, due: Due) -> None:
        if due.kind is DueKind.PREPARE:
            began_ns = time.monotonic_ns()
            self.cycle.session.turnaround_ns = self._robot.turnaround_ns or 0
            if self.cycle.prepare(due.stamp_ns):
                late_ns = self._timer.lateness.last_ns
                self._times.note_prepared(late_ns, time.monotonic_ns() - began_ns)
            return
        lost_s, may_rest = self._station.config.watch.link_lost_s, False
        if self._telegram_ns is None or due.stamp_ns - self._telegram_ns > lost_s * 1e9:
            may_rest = self._may_rest(due.stamp_ns)
            self._timer.lock.run_free(REST_S if may_rest else 0.0)
            if self._failing_ns is not None and due.stamp_ns - self._failing_ns > lost_s * 1e9:
                self._failing_ns = None
        elif self._timer.lock.is_locked:
            self._times.note_missing(due.stamp_ns)
        self._times.note_schedule(self._timer.lock)
        self.cycle.on_missing(due.stamp_ns, may_rest=may_rest)
        self._call_after_reply()

    def _may_rest(self, now_ns: int) -> bool:
        """Return whether the robot has been gone for long, and no one looks."""
        since_ns = self._began_ns if self._telegram_ns is None else self._telegram_ns
        if self.cycle.machine.state is not State.INIT or self._commands.is_watched:
            return False
        return now_ns - since_ns > REST_AFTER_S * 1e9

    def _call_after_reply(self) -> None:
        """Call ``_after`` once the reply is sent: in the loop's next turn at the latest."""
        if self._after_waits:
            return
        self._after_waits = True
        if not self._is_attending and self._loop is not None:
            self._loop.call_soon(self._after)

    def _after(self) -> None:
        if not self._after_waits:
            return
        self._after_waits = False
        try:
            self._follow()
            self._finish_cycle()
        except Exception as error:  # noqa: BLE001 - what fails here costs no reply
            self._failed(error)

    def _finish_cycle(self) -> None:
        """Record, log and report the cycle, then serve operators."""
        now_ns = time.monotonic_ns()
        entries = self.cycle.take_log()
        for entry in entries:
            same = entry.outputs.command == self._command
            self._resting = self._resting + 1 if same else 0
            self._command = entry.outputs.command
        self._cycled.set()
        self._events.log_changes(now_ns)
        self._answers.keep()
        times = self._times.close_cycle(entries, self._robot.turnaround_ns)
        incident = self._times.take_incident()
        if incident is not None:
            self._incidents.begin(incident)
        self._incidents.write_some()
        if self._recorder is not None:
            self._recorder.record(entries, times)
        self._live.record(entries, times)
        self._learners.learn(entries)
        if self._production is not None:
            self._production.advance(entries, now_ns)
        self._rest.update(now_ns)
        self._serve_operators(now_ns)
        if self._failing_ns is None:
            self._notifier.alive(now_ns)
        if self._is_status_due(now_ns):
            self._status_ns = now_ns
            self._helpers.raise_priority()
            if self._recorder is not None:
                self._recorder.restart_writer_if_lost(now_ns)
            self._rates.update((link.status for link in self._links), now_ns)
            self._events.log_links(now_ns, [link.status for link in self._links])
            if self._notifier.address:
                self._notifier.send(f"STATUS={self._line()}")
        moving = bool(entries) and entries[-1].inputs.order is not MotionOrder.HOLD
        self._collector.collect_if_due(is_moving=moving)

    def _is_status_due(self, now_ns: int) -> bool:
        """Return whether a second has passed and no step is near; two seconds are enough."""
        since_ns, lock = now_ns - self._status_ns, self._timer.lock
        if since_ns < STATUS_EVERY_NS or since_ns >= 2 * STATUS_EVERY_NS:
            return since_ns >= STATUS_EVERY_NS
        left_ns = lock.next_ns - lock.lead_ns - time.monotonic_ns()
        return not lock.is_locked or left_ns > STATUS_NS

    def _serve_operators(self, now_ns: int) -> None:
        """Handle operators' messages, and open a window until the next step is due."""
        budget, lock = self._station.config.command.budget, self._timer.lock
        if self.cycle.is_resting:
            until_ns = now_ns + 2 * LOOK_NS
        elif lock.is_locked:
            until_ns = lock.next_ns - lock.lead_ns - WINDOW_MARGIN_NS
        else:
            # Without a robot, operators delay no one.
            until_ns = max(lock.wake_ns, now_ns + lock.period_ns)
        if until_ns <= now_ns or self._commands.has_to_poll:
            self._commands.poll(budget)
        if self._loop is not None:
            self._commands.open_window(self._loop, until_ns, budget)

    def _note_parameters(
        self, parameters: Parameters, who: str, changed: Mapping[str, Any]
    ) -> None:
        if self._recorder is not None:
            self._recorder.note_change(parameters, who, changed)
        if self._production is not None:
            self._production.retune(parameters)

    def _failed(self, error: Exception) -> None:
        """Count a fault of the cycle, and log one in LOG_EVERY."""
        count = self.counters["faults"]
        self.counters["faults"] += 1
        if count % LOG_EVERY == 0:
            log.error("fault %d in the cycle", count + 1, exc_info=error)

    def _handle(
        self, op: str, params: dict[str, Any], role: str, who: str
    ) -> Answer | asyncio.Future[Answer]:
        del role  # the protocol has checked it
        self._rest.wake_up()
        if op in ORDERS and op != "follow":
            reason = self._period_refusal() if op == "arm" else None
            if self._production is not None:
                reason = reason or self._production.intercept(op, who)
            reason = reason or self.cycle.order(op, who)
            outcome = f", refused: {reason}" if reason else ""
            self._events.add(f"{who} ordered {op}{outcome}")
            return self._answers.promise(op) if reason is None else {"refused": reason}
        handler = self._operations.get(op)
        if handler is None:
            return {"refused": f"no such operation without the section production: {op}"}
        return handler(params, who)

    def _follow_poses(self, params: Mapping[str, Any], who: str) -> Answer | asyncio.Future[Answer]:
        """Hand target poses in; without any, answer the time of their clock."""
        if not params["poses"]:
            return {"now_ns": time.monotonic_ns(), "state": self.cycle.machine.state.value}
        if any(abs(row[0]) > LONGEST_CHUNK_S for row in params["poses"]):
            return {"refused": f"times beyond {LONGEST_CHUNK_S:g} s from begin_ns. Begin later."}
        follows = self.cycle.machine.state is State.FOLLOW
        begin_ns: int = params["begin_ns"]
        chunk = tuple(
            (begin_ns + round(1e9 * row[0]), *map(float, row[1:])) for row in params["poses"]
        )
        reason = self._production.intercept("follow", who) if self._production else None
        reason = reason or self.cycle.hand_in(chunk, who)
        if reason is None and follows:
            return {"state": State.FOLLOW.value}
        outcome = f", refused: {reason}" if reason else ""
        self._events.add(f"{who} handed in poses{outcome}")
        return self._answers.promise("follow") if reason is None else {"refused": reason}

    def _period_refusal(self) -> str | None:
        """Return why the controller's period forbids to arm, None if it does not.

        A wrong period is named before anything else. A period that is not measured yet is named
        last, for it is measured within a second.
        """
        estimate = self._timer.lock.estimate
        if estimate.refusal is not None or self.cycle.refusal("arm") is not None:
            return estimate.refusal
        return estimate.arm_refusal

    def _record(self, action: str) -> dict[str, Any]:
        if self._recorder is None:
            return {"refused": "no directory for recordings. Set recording.directory."}
        reason = self._recorder.start() if action == "start" else self._recorder.stop()
        self._events.repeat_links()
        if reason is None and action == "start":
            self._events.add(f"{self.cycle.machine.state}: {self.cycle.operating.cause}")
        return {"refused": reason} if reason else {"file": self._recorder.status.file}

    def status(self) -> dict[str, Any]:
        """Return the status as plain values."""
        whole = status(self._snapshot())
        if self._production is not None:
            whole["production"] = self._production.status()
        return whole

    def _telemetry(self) -> dict[str, Any]:
        nominal = self.cycle.parameters.tracker.reference.nominal
        return telemetry(self.cycle) | self._live.snapshot(nominal)

    def _snapshot(self) -> DaemonSnapshot:
        links = [
            LinkView(link.status, getattr(link, "address", None), self._rates.of(link.status.name))
            for link in self._links
        ]
        return DaemonSnapshot(
            task=self._station.task.file.name,
            now_ns=time.monotonic_ns(),
            began_ns=self._began_ns,
            cycle=self.cycle,
            links=tuple(links),
            timer=self._timer,
            timing=self._times.timing,
            recorder=None if self._recorder is None else self._recorder.status,
            commands=self._commands.status(),
            refusals=self._host.refusals(),
            counters=self.counters,
        )

    def _line(self) -> str:
        machine = self.cycle.machine
        return f"{machine.state.upper()} ({machine.because}), {self.cycle.steps} steps"

    def listening(self) -> dict[str, Any]:
        """Return the addresses of the daemon, with the ports that the system chose."""
        command = self._station.config.command
        camera = [link.address for link in self._sensors if isinstance(link, CameraLink)]
        socket = command.socket and str(self._station.path.parent / command.socket)
        return {
            "pid": os.getpid(),
            "robot": self._robot.address,
            "camera": camera[0] if camera else None,
            "command": {"socket": socket, "udp": self._commands.udp_address},
        }
