"""Event log: lines about the state, the sensors and the links.

Each line goes to the journal, to the recording and to the live telemetry.
"""

import logging
import time
from collections.abc import Sequence
from typing import Final

from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.recording.format import STATE_LOG
from linemate.daemon.recording.recorder import Recorder
from linemate.daemon.service.journal import Journal, SensorChanges
from linemate.daemon.service.live_telemetry import LiveTelemetry
from linemate.daemon.service.status import covered
from linemate.drivers.link import NOT_OPENED, LinkStatus

STATE_LINES: Final = 4  # of state changes in the journal in any second
DEVICE_LINES: Final = 3  # of links and sensors in the journal in any second
SENSORS_EVERY_NS: Final = 20_000_000  # between two checks of the sensors [ns]

state_log = logging.getLogger("linemate.state")
device_log = logging.getLogger("linemate.device")


class EventLog:
    """Lines about one daemon."""

    def __init__(self, cycle: Cycle, recorder: Recorder | None, telemetry: LiveTelemetry) -> None:
        self._cycle = cycle
        self._recorder = recorder
        self._telemetry = telemetry
        self._state_journal = Journal(state_log.info, STATE_LINES)
        self._device_journal = Journal(device_log.info, DEVICE_LINES)
        self._sensors = SensorChanges()
        self._sensors_checked_ns = 0
        self._links_up: dict[str, bool] = {}
        self._waits = False

    def add(self, text: str, stamp_ns: int | None = None, name: str = "linemated") -> None:
        """Add a line to the recording and the telemetry.

        Args:
            stamp_ns: monotonic time [ns], None for now.
            name: writer of the line in the recording.
        """
        at_ns = time.monotonic_ns() if stamp_ns is None else stamp_ns
        self._telemetry.add_event(at_ns, text)
        if self._recorder is not None:
            self._recorder.write_line(at_ns, text, name=name)

    def log_changes(self, now_ns: int) -> None:
        """Log changes of the state with their reason, and sensors that came or went."""
        for change in self._cycle.take_changes():
            self._state_journal.write_line(now_ns, str(change))
            self.add(str(change), change.stamp_ns, STATE_LOG)
        if now_ns - self._sensors_checked_ns < SENSORS_EVERY_NS:
            return
        self._log_waiting(now_ns)
        self._sensors_checked_ns = now_ns
        settings = self._cycle.operating.settings
        limits_s = {
            "distance": settings.position_s,
            "camera": settings.position_s,
            "force_torque": settings.wrench_s,
        }
        sensors = self._cycle.samples.facts()
        lines = self._sensors.changes(now_ns, sensors, limits_s, covered(self._cycle))
        self._add_device_lines(now_ns, lines)
        self._state_journal.catch_up(now_ns)
        self._device_journal.catch_up(now_ns)

    def _log_waiting(self, now_ns: int) -> None:
        """Log that the tool begins or ends to wait before contact, with the reason."""
        last = self._cycle.last
        waiting = None if last is None else last.outputs.waiting
        if (waiting is not None) is self._waits:
            return
        self._waits = waiting is not None
        line = "go: no longer waiting before contact"
        if waiting is not None:
            line = f"no-go: waiting before contact: {waiting}"
        self._state_journal.write_line(now_ns, line)
        self.add(line, now_ns, STATE_LOG)

    def log_links(self, now_ns: int, links: Sequence[LinkStatus]) -> None:
        """Log links that came up or went down."""
        lines = []
        for link in links:
            was_up = self._links_up.get(link.name)
            if was_up == link.up or (was_up is None and link.reason == NOT_OPENED):
                continue
            self._links_up[link.name] = link.up
            reason = "" if link.up else f": {link.reason}"
            lines.append(f"link {link.name} is {'up' if link.up else 'down'}{reason}")
        self._add_device_lines(now_ns, lines)

    def repeat_links(self) -> None:
        """Log every link again, for a recording that begins."""
        self._links_up.clear()

    def _add_device_lines(self, now_ns: int, lines: Sequence[str]) -> None:
        """Write one joined line to the journal, and each line to the recording."""
        if lines:
            self._device_journal.write_line(now_ns, "; ".join(lines))
        for text in lines:
            self.add(text, now_ns)
