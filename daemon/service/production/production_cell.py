"""Production in the process: operations of the command protocol, variants, and records.

Invariants:
- Every task is compiled at start. No file is read after that, and records are written in a thread.
- While production runs, an order to arm, start or go home by hand is refused.
- A stop or a retreat that an operator orders puts production on hold at once.
"""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Final

from linemate.daemon.config.settings import ProductionSettings
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.step_log import LogEntry
from linemate.daemon.production import record as records
from linemate.daemon.production.object_queue import AnnouncedPart
from linemate.daemon.production.record import PartRecord
from linemate.daemon.production.supervisor import WHO, CellView, PartResult, Supervisor
from linemate.daemon.service.production.record_files import RecordFiles

STOPS: Final = frozenset({"stop", "retreat"})
BY_HAND: Final = frozenset({"arm", "start", "home", "follow"})

Answer = dict[str, Any]


class ProductionCell:
    """One cell that brings part after part.

    Attributes:
        operations: by name, as the command server calls them.
    """

    def __init__(
        self,
        settings: ProductionSettings,
        cycle: Cycle,
        variants: Mapping[str, Parameters],
        files: RecordFiles,
        *,
        refusal: Callable[[str], str | None],
        on_event: Callable[[str], None],
        on_task: Callable[[Parameters, str], None],
        recording: Callable[[], str | None],
    ) -> None:
        """Begin on hold.

        Args:
            variants: compiled parameters by variant.
            refusal: returns why an order is refused now, for reasons of the process.
            on_event: takes a line for the log.
            on_task: called before the parameters of another variant are used.
            recording: returns the file that is being recorded, None without one.
        """
        self._settings, self._cycle, self._files = settings, cycle, files
        self._variants = dict(variants)
        self._refusal, self._on_event, self._on_task = refusal, on_event, on_task
        self._recording = recording
        starts = {
            name: compiled.tracker.task.conveyor.start_position
            for name, compiled in variants.items()
        }
        self._supervisor = Supervisor(settings, self, starts)
        self._record: PartRecord | None = None
        self._lost_before = 0
        self._last: dict[str, Any] | None = None
        self.operations: dict[str, Callable[[Mapping[str, Any], str], Answer]] = {
            "announce": self._announce,
            "skip": self._skip,
            "next": self._next,
            "hold": self._hold,
            "queue": lambda _params, _who: self.status(),
        }

    # Orders by hand.

    def intercept(self, op: str, who: str) -> str | None:
        """Return why an operator's order is refused because production runs, None if it is not."""
        if op in STOPS:
            self._supervisor.interrupt(f"{op} ordered by {who}")
        if op in BY_HAND and self._supervisor.held is None:
            return "production runs. Order hold first."
        return None

    def _announce(self, params: Mapping[str, Any], _who: str) -> Answer:
        distance = params.get("distance", self._cycle.samples.reading)
        if distance is None:
            return {"refused": "the distance sensor has given no reading. Give distance."}
        part = AnnouncedPart(params["part"], params["variant"], float(distance))
        reason = self._supervisor.queue.announce(part)
        return {"refused": reason} if reason else self._brief()

    def _skip(self, params: Mapping[str, Any], who: str) -> Answer:
        reason = self._supervisor.skip(params.get("part"))
        if reason is None:
            self._on_event(f"{who} skipped {params.get('part') or 'the next part'}")
        return {"refused": reason} if reason else self._brief()

    def _next(self, _params: Mapping[str, Any], who: str) -> Answer:
        self._supervisor.release()
        self._on_event(f"{who} let production go on")
        return self._brief()

    def _hold(self, _params: Mapping[str, Any], who: str) -> Answer:
        self._supervisor.hold(f"hold ordered by {who}")
        return self._brief()

    # The cycle.

    def advance(self, entries: Sequence[LogEntry], now_ns: int) -> None:
        """Add the steps to the record, and give the order that is due."""
        record = self._record
        if record is not None:
            for entry in entries:
                record.add(entry)
        cycle, last = self._cycle, self._cycle.last
        self._supervisor.supervise(
            CellView(
                now_ns,
                cycle.machine,
                cycle.operating.cause,
                cycle.operating.decisions,
                cycle.samples.reading,
                is_home=cycle.is_home,
                stands=cycle.stands,
                unseen=record is not None and not record.seen,
                waiting=None if last is None else last.outputs.waiting,
            )
        )

    def retune(self, parameters: Parameters) -> None:
        """Use the tuning of the estimators of some parameters for every variant from now on."""
        tracking = parameters.tracker.settings
        self._variants = {
            name: compiling.retuned(compiled, tracking) for name, compiled in self._variants.items()
        }

    # ``CellControl`` for the supervisor.

    def refusal(self, op: str) -> str | None:
        """Return why an order would be refused now, None if it would not."""
        return self._refusal(op) or self._cycle.refusal(op)

    def order(self, op: str) -> str | None:
        """Give an order; return why it is refused, or None."""
        reason = self.refusal(op) or self._cycle.order(op, WHO)
        if reason is None:
            self._on_event(f"{WHO} ordered {op}")
        return reason

    def begin_part(self, part: AnnouncedPart) -> None:
        """Use the task of the part's variant from now on, for a robot that stands."""
        compiled = self._variants[part.variant]
        self._on_task(compiled, part.variant)
        self._cycle.begin_object(compiled, self._supervisor.offset(part))
        self._record = PartRecord(part, time.monotonic_ns(), _utc(), self._settings.name)
        self._lost_before = self._cycle.session.replies_lost
        self._on_event(f"part {part.part} of variant {part.variant} begins")

    def end_part(self, result: PartResult) -> None:
        """Take the result of a part."""
        record, station = self._record, self._settings.name
        if record is not None and record.part is result.part:
            self._record = None
            plain = record.finish(
                time.monotonic_ns(),
                is_good=result.is_good,
                reason=result.reason,
                replies_lost=self._cycle.session.replies_lost - self._lost_before,
                recording=self._recording(),
            )
        else:
            plain = records.missed(result.part, _utc(), station, result.reason)
        self._files.add(plain)
        self._last = {name: plain[name] for name in ("part", "variant", "ok", "reason")}
        outcome = "good" if result.is_good else f"not good: {result.reason}"
        self._on_event(f"part {result.part.part}: {outcome}")

    def status(self) -> dict[str, Any]:
        """Return the state of production as plain values."""
        supervisor, reading = self._supervisor, self._cycle.samples.reading
        return {
            "state": self._cycle.machine.state.value,
            "held": supervisor.held,
            "stage": str(supervisor.stage),
            "part": None if supervisor.part is None else self._shown(supervisor.part, reading),
            "queue": [self._shown(part, reading) for part in supervisor.queue.waiting],
            "counts": dict(supervisor.counts),
            "last": self._last,
            "variants": list(self._variants),
            "at_home": self._cycle.is_home,
            "reading": reading,
            "records": {
                "written": self._files.written,
                "failed": self._files.failed,
                "dropped": self._files.dropped,
            },
        }

    def _brief(self) -> Answer:
        supervisor = self._supervisor
        return {"held": supervisor.held, "waiting": len(supervisor.queue)}

    def _shown(self, part: AnnouncedPart, reading: float | None) -> dict[str, Any]:
        position = None if reading is None else self._supervisor.position(part, reading)
        return {"part": part.part, "variant": part.variant, "position": position}


def _utc() -> str:
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(time.time_ns() / 1e9))
