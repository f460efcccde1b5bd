"""``linemated`` with an account of its processor time by part, for ``bench --parts cpu``.

Each function of ``PARTS`` is wrapped. A part's time is exclusive: what a function calls of another
part counts there. Only cycles in which the robot moves count. The account is written next to the
daemon's configuration.

Invariants:
    A part that no longer exists is an error at the start.
    The main thread is measured by its own processor time; other threads count as a whole.
"""

from __future__ import annotations

import functools
import json
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import Any, Final

from linemate.simulators.lab.bench import memory_parts

FILE: Final = "cpu.json"
REST: Final = "asyncio and the rest"
THREADS: Final = "other threads"

PARTS: Final[tuple[tuple[str, str, str], ...]] = (
    ("tracking", "core.tracking.tracker", "track"),
    ("tracking", "core.tracking.tracker", "observe"),
    ("tracking", "core.tracking.contact_decision", "update_contact"),
    ("control", "core.control.controller", "desire_command"),
    ("control", "core.control.controller", "limit_command"),
    ("control", "core.control.controller", "stop"),
    ("step: inputs and outputs", "core.step", "plan"),
    ("step: inputs and outputs", "core.step", "finish"),
    ("cycle", "cycle.cycle", "Cycle.prepare"),
    ("cycle", "cycle.cycle", "Cycle.on_telegram"),
    ("cycle", "cycle.cycle", "Cycle.on_missing"),
    ("clock", "cycle.clock.timer", "CycleTimer._wake"),
    ("clock", "service.app", "App._follow"),
    ("app", "service.app", "App._on_due"),
    ("app", "service.app", "App._on_telegram"),
    ("app", "service.app", "App._after"),
    ("service: timing", "service.cycle_timing", "CycleTiming.close_cycle"),
    ("service: recording", "recording.recorder", "Recorder.record"),
    ("service: live telemetry", "service.live_telemetry", "LiveTelemetry.record"),
    ("service: operators", "service.app", "App._serve_operators"),
    ("service: operators", "service.command_server", "CommandPort._serve_window"),
    ("service: collector", "service.host.realtime", "Collector.collect_if_due"),
    ("protocol", "/protocol.rsi.rsi_link", "RsiLink.read"),
    ("protocol", "/protocol.rsi.rsi_link", "RsiLink.expect"),
    ("protocol", "/protocol.rsi.rsi_link", "RsiLink.prepare"),
    ("link of the robot", "/drivers.udp.robot_udp", "RobotLink.attend"),
    ("link of the robot", "/drivers.udp.robot_udp", "RobotLink._read"),
    ("feed links", "/drivers.can_bus", "CanLink._readable"),
    ("feed links", "/drivers.udp.camera_udp", "CameraLink._read"),
    ("feed links", "/drivers.serial_port", "_SerialProtocol.data_received"),
)
"""Part, module below ``linemate.daemon`` (after a slash: below ``linemate``), function."""

CLOSES: Final = "App._after"
"""The function whose end is the end of a cycle."""


@dataclass(slots=True)
class Account:
    """Exclusive processor time by part [ns].

    Attributes:
        clock: processor time of the calling thread [ns].
        spent: since the last ``close_cycle``, by part.
        total: of all cycles that counted.
        calls: of wrapped functions in these cycles.
    """

    clock: Callable[[], int] = time.thread_time_ns
    process: Callable[[], int] = time.process_time_ns
    spent: dict[str, int] = field(default_factory=dict)
    total: dict[str, int] = field(default_factory=dict)
    calls: int = 0
    cycles: int = 0
    _stack: list[str] = field(default_factory=list)
    _since: int = 0
    _calls: int = 0
    _begun: tuple[int, int] | None = None

    def enter(self, part: str) -> None:
        """Charge what has passed to the part that ran, and begin another one."""
        self._switch()
        self._stack.append(part)
        self._calls += 1

    def leave(self) -> None:
        """Charge what has passed to the part that ran, and go back to its caller."""
        self._switch()
        self._stack.pop()

    def _switch(self) -> None:
        now = self.clock()
        if self._stack:
            part = self._stack[-1]
            self.spent[part] = self.spent.get(part, 0) + now - self._since
        self._since = now

    def close_cycle(self, *, counts: bool) -> None:
        """End a cycle; what was spent in it counts or is forgotten."""
        main, process = self.clock(), self.process()
        begun, self._begun = self._begun, (main, process)
        spent, self.spent = self.spent, {}
        calls, self._calls = self._calls, 0
        if begun is None or not counts:
            return
        used = main - begun[0]
        spent[REST] = used - sum(spent.values())
        spent[THREADS] = process - begun[1] - used
        for part, ns in spent.items():
            self.total[part] = self.total.get(part, 0) + ns
        self.calls += calls
        self.cycles += 1


def wrapped(account: Account, part: str, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return a function that charges its time to a part."""

    @functools.wraps(function)
    def charged(*args: Any, **kwargs: Any) -> Any:
        account.enter(part)
        try:
            return function(*args, **kwargs)
        finally:
            account.leave()

    return charged


def closing(account: Account, function: Callable[..., Any]) -> Callable[..., Any]:
    """Return ``App._after`` with the end of the cycle behind it."""
    from linemate.daemon.cycle import states

    @functools.wraps(function)
    def closed(app: Any) -> None:
        function(app)
        account.close_cycle(counts=app.cycle.machine.state in states.MOVING)

    return closed


def install(account: Account) -> None:
    """Wrap each function of ``PARTS``.

    Raises:
        AttributeError, ModuleNotFoundError: a part is not there any more.
    """
    for part, module, name in PARTS:
        below = "linemate" if module.startswith("/") else "linemate.daemon"
        holder: Any = import_module(f"{below}.{module.lstrip('/')}")
        *classes, attribute = name.split(".")
        for each in classes:
            holder = getattr(holder, each)
        function = wrapped(account, part, getattr(holder, attribute))
        setattr(holder, attribute, closing(account, function) if name == CLOSES else function)


def cost_of_a_call(calls: int = 20_000) -> float:
    """Return what the measurement itself adds to a wrapped call [ns]."""
    account = Account()
    empty = wrapped(account, "empty", lambda: None)
    begin = time.thread_time_ns()
    for _ in range(calls):
        empty()
    return (time.thread_time_ns() - begin) / calls


def figures(account: Account, call_ns: float) -> dict[str, Any]:
    """Return the account as plain values: microseconds a cycle by part."""
    cycles = max(1, account.cycles)
    parts = {part: ns * 1e-3 / cycles for part, ns in account.total.items()}
    return {
        "cycles": account.cycles,
        "parts_us": {part: round(us, 1) for part, us in sorted(parts.items())},
        "all_us": round(sum(parts.values()), 1),
        "measurement_us": round(account.calls / cycles * call_ns * 1e-3, 1),
    }


def main() -> int:
    """Run the daemon, and write the account at its end."""
    from linemate.daemon.service import main as daemon

    account = Account()
    call_ns = cost_of_a_call()
    install(account)
    config = Path(sys.argv[sys.argv.index("--config") + 1])
    try:
        return daemon.main()
    finally:
        taken = figures(account, call_ns) | {"memory_mib": memory_parts.resident()}
        text = json.dumps(taken)
        (config.parent / FILE).write_text(text, encoding="utf-8")


if __name__ == "__main__":
    sys.exit(main())
