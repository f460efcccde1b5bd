"""Turn-around of the daemon's process next to a program that only echoes.

Invariants:
    Idle and loaded rounds take turns.
    A ratio is the median over rounds of the daemon's figure by the echo's.
    A late reply is excused only if a probe of higher priority was stalled as long.
"""

from __future__ import annotations

import json
import socket
import sys
import time
from array import array
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from select import select
from statistics import median
from typing import Any, Final

import yaml

from linemate.daemon.transport.client import Client, RefusedError
from linemate.simulators.harness.processes import START_S, Child, Children, start_daemon
from linemate.simulators.lab.bench.bench_floor import (
    Hogs,
    Place,
    Spike,
    TimerProgram,
    c_timer,
    cpu_ns,
    start_echo,
)

PRIORITIES: Final = {"probe": 90, "player": 85, "echo": 81, "daemon": 80}
"""The echo has a higher priority than the daemon: it shows what the machine can do."""

PROBE_PERIOD_NS: Final = 1_000_000
SPIKE_NS: Final = 150_000
MOVING: Final = {"track", "contact"}
AT_WORK_S: Final = 8.0
LEAST_CYCLES: Final = 100
WARM_S: Final = 0.3
LOOK_S: Final = 1.0
"""Between two looks at a daemon that moves the robot [s]; each look costs it time."""

OPERATE_S: Final = 0.1
"""Between two orders to a daemon that does not [s]."""

WAKE_PERIOD_NS: Final = 4_000_000
NEVER_NS: Final = 1 << 60
MODES: Final = ("idle", "loaded")


@dataclass(frozen=True, slots=True)
class Bench:
    """What is measured, and with what.

    Attributes:
        trace: file of the trace that is played.
        program: the C programs, None without a compiler.
        fifo: real-time priorities are granted.
        cpus: the cores there are.
    """

    trace: Path
    program: Path | None
    folder: Path
    fifo: bool
    rounds: int
    round_s: float
    cpus: tuple[int, ...]

    def place(self, name: str) -> Place:
        """Return where a process runs: the player on one core, all else on another."""
        cpu = self.cpus[0] if name == "player" else self.cpus[-1]
        return Place(cpu, PRIORITIES[name] if self.fifo else None)


@dataclass(frozen=True, slots=True)
class Round:
    """One round's times [ns]; -1 for a reply that never came."""

    sent_ns: Sequence[int]
    daemon_ns: Sequence[int]
    echo_ns: Sequence[int]
    cpu_ns: float
    prepared: float | None

    @classmethod
    def read(cls, path: Path, cpu_ns: float, prepared: float | None) -> Round:
        """Take a round from the player's file of three columns."""
        times = array("q")
        times.frombytes(path.read_bytes())
        n = len(times) // 3
        return cls(times[:n], times[n : 2 * n], times[2 * n :], cpu_ns, prepared)


@dataclass(frozen=True, slots=True)
class Measured:
    """What one cycle's rounds came to.

    Attributes:
        cpu_per_cycle_us: of the daemon, all its threads, in the first mode [us].
        start_s: from the daemon's start to its first word of being ready [s].
        state: the daemon's as the rounds began; not of `MOVING` where the machine is too slow.
    """

    modes: dict[str, dict[str, Any]]
    cpu_per_cycle_us: float
    start_s: float
    state: str
    status: dict[str, Any]


def percentile(values: Sequence[int], share: float) -> float:
    """The value that a share of all does not exceed; infinite for replies that never came."""
    ordered = sorted(float("inf") if value < 0 else float(value) for value in values)
    return ordered[min(len(ordered) - 1, int(share * len(ordered)))]


def is_explained(sent_ns: int, took_ns: int, cycle_ns: int, spikes: Sequence[Spike]) -> bool:
    """Whether the machine itself made a reply late.

    Args:
        sent_ns: when the telegram left [ns].
        took_ns: until its reply [ns], -1 if that never came.
        cycle_ns: what it should have taken at most [ns].
        spikes: when the probe stood still; it looked once in ``PROBE_PERIOD_NS``, so a stand-still
            may have begun that much earlier.
    """
    if took_ns < 0:
        took_ns = 2 * cycle_ns
    stood_ns = sum(
        max(0, min(spike.woke_ns, sent_ns + took_ns) - max(spike.due_ns - PROBE_PERIOD_NS, sent_ns))
        for spike in spikes
    )
    return stood_ns >= took_ns - cycle_ns


def figures(rounds: Sequence[Round], cycle_ns: int, spikes: Sequence[Spike]) -> dict[str, Any]:
    """What the rounds of one mode come to, keys as in the bench's JSON."""
    figures: dict[str, Any] = {}
    for name, share in (("p50", 0.5), ("p99", 0.99)):
        daemon = [percentile(run.daemon_ns, share) for run in rounds]
        echo = [percentile(run.echo_ns, share) for run in rounds]
        figures[f"{name}_us"] = _finite(median(daemon) * 1e-3, 1)
        figures[f"echo_{name}_us"] = _finite(median(echo) * 1e-3, 1)
        figures[f"{name}_ratio"] = _finite(
            median(a / b if b < float("inf") else 1.0 for a, b in zip(daemon, echo, strict=True)), 3
        )
    late = [
        (sent, turnaround_ns)
        for run in rounds
        for sent, turnaround_ns in zip(run.sent_ns, run.daemon_ns, strict=True)
        if turnaround_ns < 0 or turnaround_ns > cycle_ns
    ]
    shares = [run.prepared for run in rounds if run.prepared is not None]
    figures["late"] = len(late)
    # What a program without any work of its own, one priority above, does no better.
    figures["echo_late"] = sum(
        turnaround_ns < 0 or turnaround_ns > cycle_ns
        for run in rounds
        for turnaround_ns in run.echo_ns
    )
    figures["late_unexplained"] = sum(
        not is_explained(sent, turnaround_ns, cycle_ns, spikes) for sent, turnaround_ns in late
    )
    figures["cycles"] = sum(len(run.sent_ns) for run in rounds)
    figures["prepared"] = round(median(shares), 4) if shares else None
    return figures


def _finite(value: float, digits: int) -> float | None:
    return round(value, digits) if value < float("inf") else None


def measure(
    bench: Bench, cycle_us: int, *, prepared: bool, modes: Sequence[str] = MODES
) -> Measured:
    """Measure one cycle, with replies made beforehand or in line.

    Args:
        prepared: replies are made beforehand.
        modes: idle, loaded or both; they take turns.

    Raises:
        ChildError, NoAnswerError, TimeoutError: it did not come to an end.
    """
    with Children() as children:
        run = _BenchProcesses(bench, children, cycle_us, prepared=prepared)
        try:
            return run.measure(modes)
        finally:
            run.close()


def wakeup(bench: Bench) -> dict[str, float] | None:
    """Compare the daemon's clock with the C timer: same core, same seconds, same priority.

    Returns:
        Medians over rounds [us] and of the rounds' ratio; None without a compiler.
    """
    if bench.program is None:
        return None
    place = bench.place("daemon")
    with Children() as children:
        ours = [sys.executable, "-m", "linemate.simulators.lab.bench.bench_clock"]
        timers = [
            TimerProgram(children, command, bench.folder / f"{name}.log", place)
            for name, command in (
                ("clock", [*ours, str(WAKE_PERIOD_NS)]),
                ("timer", c_timer(bench.program, WAKE_PERIOD_NS, NEVER_NS)),
            )
        ]
        rounds = []
        for number in range(-1, bench.rounds):
            for timer in timers:
                timer.lateness()
            time.sleep(max(1.0, bench.round_s))
            lateness = [timer.lateness() for timer in timers]
            if number >= 0:
                rounds.append(lateness)
    return {
        "p50_us": round(median(clock.p50_ns for clock, _ in rounds) * 1e-3, 1),
        "c_p50_us": round(median(timer.p50_ns for _, timer in rounds) * 1e-3, 1),
        "p99_us": round(median(clock.p99_ns for clock, _ in rounds) * 1e-3, 1),
        "c_p99_us": round(median(timer.p99_ns for _, timer in rounds) * 1e-3, 1),
        "p99_ratio": round(median(a.p99_ns / max(1, b.p99_ns) for a, b in rounds), 3),
    }


class _BenchProcesses:
    """The processes of one measurement.

    Attributes:
        start_s: from the daemon's start to its word of being ready [s].
    """

    def __init__(self, bench: Bench, children: Children, cycle_us: int, *, prepared: bool) -> None:
        self._bench, self._children, self._cycle_us = bench, children, cycle_us
        self._folder = bench.folder / f"{cycle_us}-{'prepared' if prepared else 'inline'}"
        self._folder.mkdir()
        self._control = self._start_player()
        player = json.loads(self._control.recv(4096))
        begin = time.monotonic()
        self._daemon, listening = self._start_daemon(player, prepared=prepared)
        self.start_s = round(time.monotonic() - begin, 3)
        echo = start_echo(children, bench.program, self._folder, bench.place("echo"))
        self._probes = self._start_probes()
        self._hogs = Hogs(children, self._folder, bench.cpus)
        self._client = Client.local(self._folder / "command.sock")
        order = {"robot": listening["robot"], "camera": listening["camera"], "echo": echo}
        self._control.send(json.dumps(order).encode())

    def close(self) -> None:
        """Let go; the children end with their owner."""
        self._client.close()
        self._control.close()

    def measure(self, modes: Sequence[str]) -> Measured:
        """Run all rounds, the modes in turns."""
        rounds: dict[str, list[Round]] = {mode: [] for mode in modes}
        state = self._bring_to_work()
        for number in range(self._bench.rounds):
            for mode in modes if number % 2 == 0 else reversed(modes):
                if mode == "loaded":
                    self._hogs.loose()
                rounds[mode].append(self._round())
                self._hogs.stop()
        for probe in self._probes:
            probe.lateness()
        spikes = [spike for probe in self._probes for spike in probe.spikes]
        record = {
            mode: figures(rounds_of_mode, 1000 * self._cycle_us, spikes)
            for mode, rounds_of_mode in rounds.items()
        }
        first = rounds[modes[0]]
        spent = median(run.cpu_ns / max(1, len(run.sent_ns)) for run in first)
        cpu_us = round(spent * 1e-3, 1)
        return Measured(record, cpu_us, self.start_s, state, self._status())

    def _round(self) -> Round:
        cycles = max(LEAST_CYCLES, round(1e6 * self._bench.round_s / self._cycle_us))
        path = self._folder / "round"
        path.unlink(missing_ok=True)
        before, spent = self._counted(), cpu_ns(self._daemon.pid)
        order = {"measure": cycles, "file": str(path)}
        self._control.send(json.dumps(order).encode())
        end = time.monotonic() + START_S + 10e-6 * cycles * self._cycle_us
        wait_s = OPERATE_S
        while not select([self._control], [], [], wait_s)[0]:
            wait_s = LOOK_S if self._operate() in MOVING else OPERATE_S
            if time.monotonic() > end:
                raise TimeoutError(f"a round of {cycles} cycles did not end")
        measured = json.loads(self._control.recv(4096))["measured"]
        spent = cpu_ns(self._daemon.pid) - spent
        after = self._counted()
        prepared, total = after[0] - before[0], after[1] - before[1]
        share = prepared / total if total else None
        # Cycles that a pass' begin cost are not measured, but were computed.
        return Round.read(path, spent * measured / max(total, 1), share)

    def _counted(self) -> tuple[int, int]:
        """Return how many replies were prepared, and how many steps were made."""
        status = self._status()
        return status["prepared"], status["steps"]

    def _status(self) -> dict[str, Any]:
        return self._client.call("status", timeout_s=5.0)

    def _operate(self) -> str:
        """Give the order that brings the daemon to work, if it is not there."""
        self._children.check()
        state = str(self._status().get("state"))
        order = {"idle": "arm", "armed": "start", "fault": "ack", "hold": "ack"}.get(state)
        if order is not None:
            with suppress(RefusedError):
                self._client.call(order, timeout_s=5.0)
        return state

    def _bring_to_work(self) -> str:
        """Wait until the daemon moves the robot, but not for ever; return its state."""
        end = time.monotonic() + AT_WORK_S
        state = ""
        while state not in MOVING and time.monotonic() < end:
            state = self._operate()
            time.sleep(0.02)
        time.sleep(WARM_S)
        return state

    def _start_player(self) -> socket.socket:
        here, there = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with there:
            command = [
                sys.executable, "-m", "linemate.simulators.lab.bench.bench_player",
                "--trace", str(self._bench.trace), "--cycle-us", str(self._cycle_us),
                "--control-fd", str(there.fileno()),
            ]  # fmt: skip
            log = self._folder / "player.log"
            player = self._children.start("player", command, log, keep=[there.fileno()])
        self._bench.place("player").assign(player.pid)
        here.settimeout(START_S)
        return here

    def _start_daemon(
        self, player: Mapping[str, str], *, prepared: bool
    ) -> tuple[Child, dict[str, Any]]:
        place = self._bench.place("daemon")
        configuration = {
            "task": "wheel.yaml",
            "rsi": {"port": 0, "cycle_ms": self._cycle_us // 1000},
            "distance": {"can": {"interface": "slcan", "channel": player["can"]}},
            "camera": {"port": 0},
            "force_torque": {"url": player["force_torque"]},
            "command": {"socket": "command.sock"},
            "recording": {"directory": ".", "at_start": True},
            "realtime": {
                **({"priority": place.priority, "lock_memory": True} if place.priority else {}),
                "cpus": [place.cpu],
                **({} if prepared else {"lead_ms": 0.0}),
            },
        }
        path = self._folder / "daemon.yaml"
        path.write_text(yaml.safe_dump(configuration, sort_keys=False), encoding="utf-8")
        return start_daemon(self._children, path, self._folder / "daemon.log")

    def _start_probes(self) -> list[TimerProgram]:
        """One on each core that matters, the daemon's last."""
        if self._bench.program is None:
            return []
        cpus = dict.fromkeys((self._bench.cpus[0], self._bench.cpus[-1]))
        priority = self._bench.place("probe").priority
        return [
            TimerProgram(
                self._children, c_timer(self._bench.program, PROBE_PERIOD_NS, SPIKE_NS),
                self._folder / f"probe{cpu}.log", Place(cpu, priority),
            )
            for cpu in cpus
        ]  # fmt: skip
