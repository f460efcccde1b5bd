"""Planted errors: does the fault campaign find each within 500 runs?

``python -m linemate.simulators.lab.faults.dst_planted [NAME ...] [--runs 500] [--first SEED]``
plants one error at a time in the daemon. It counts the runs to the first violation that the error
causes. It ends with 1 if one was not found.
"""

import argparse
import contextlib
import sys
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any, get_args
from unittest import mock

from msgspec import structs

from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.control import command_limiter
from linemate.daemon.core.control.command_limiter import LimiterState
from linemate.daemon.core.inputs import MotionOrder
from linemate.daemon.core.tracking import task_clock
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.cycle import states, watch
from linemate.daemon.cycle.sensing.samples import DrainedSamples, SensorQueues
from linemate.daemon.cycle.sensing.sensor_health import CameraHealth, DistanceHealth, WrenchHealth
from linemate.daemon.cycle.session import Session
from linemate.daemon.cycle.states import Link, Machine, State
from linemate.daemon.cycle.watch import Facts
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.sensors.camera_codec import CameraDecoder
from linemate.protocol.sensors.distance import DistanceDecoder
from linemate.protocol.sensors.wrench_stream import WrenchDecoder
from linemate.simulators.lab.faults import dst_plan, dst_run
from linemate.simulators.lab.faults.dst_plan import CycleMs
from linemate.simulators.plants.contact_plant import RELEASE_WHEEL

RUNS = 500
OFF_M = 0.03
COASTING_S = 3.0

Observe = Callable[[watch.Watch, Facts, Any, WatchSettings], tuple[watch.Watch, Any]]
Patch = tuple[Any, str, Any]
"""What is replaced: an owner, a name, and the wrong thing."""


def _facts(**wrong: Callable[[Facts], Any]) -> list[Patch]:
    whole: Observe = watch.observe

    def observe(
        before: watch.Watch, facts: Facts, machine: Any, settings: WatchSettings
    ) -> tuple[watch.Watch, Any]:
        changes: dict[str, Any] = {name: wrong_value(facts) for name, wrong_value in wrong.items()}
        return whole(before, structs.replace(facts, **changes), machine, settings)

    return [(watch, "observe", observe)]


def _settings(**wrong: Any) -> list[Patch]:
    """Patch the watch's time-outs."""
    whole: Observe = watch.observe
    known = {name: value for name, value in wrong.items() if hasattr(WatchSettings(), name)}

    def observe(
        before: watch.Watch, facts: Facts, machine: Any, settings: WatchSettings
    ) -> tuple[watch.Watch, Any]:
        return whole(before, facts, machine, replace(settings, **known))

    return [(watch, "observe", observe)]


def _signals(**wrong: Any) -> list[Patch]:
    """Patch what the watch concludes, where a link has been healthy once."""
    whole: Observe = watch.observe

    def observe(
        before: watch.Watch, facts: Facts, machine: Any, settings: WatchSettings
    ) -> tuple[watch.Watch, Any]:
        after, signals = whole(before, facts, machine, settings)
        moving = str(machine.state) in {"track", "contact", "hold", "retreat"}
        return after, replace(signals, **wrong) if moving else signals

    return [(watch, "observe", observe)]


def _camera_off() -> list[Patch]:
    whole = CameraDecoder.feed

    def feed(self: CameraDecoder, data: bytes, stamp_ns: int) -> Any:
        sample = whole(self, data, stamp_ns)
        x, y, z = sample.position
        return structs.replace(sample, position=(x, y + OFF_M, z))

    return [(CameraDecoder, "feed", feed)]


def _distance_off() -> list[Patch]:
    """A jump of 30 mm is used as if the object had jumped."""
    whole = DistanceDecoder.decode
    count: dict[int, int] = {}

    def decode(self: DistanceDecoder, *args: Any, **options: Any) -> Any:
        sample = whole(self, *args, **options)
        if sample is None:
            return None
        seen = count[id(self)] = count.get(id(self), 0) + 1
        return structs.replace(sample, position=sample.position + OFF_M) if seen > 60 else sample

    return [(DistanceDecoder, "decode", decode), (DistanceHealth, "accepts", lambda *_: True)]


def _overload_never() -> list[Patch]:
    whole = SensorQueues.drain

    def drain(self: SensorQueues, *args: Any) -> DrainedSamples:
        samples = whole(self, *args)
        self.overloaded = False
        return samples

    return [(SensorQueues, "drain", drain)]


def _every_sample_believed() -> list[Patch]:
    return [
        (DistanceHealth, "accepts", lambda *_: True),
        (CameraHealth, "accepts", lambda *_: True),
        (CameraHealth, "contradicts", property(lambda _: False)),
        (WrenchHealth, "accepts", lambda *_: True),
    ]


def _crc_unchecked() -> list[Patch]:
    whole = WrenchDecoder.__init__

    class Matching(int):
        """A check sum that equals every other."""

        def __eq__(self, _other: object) -> bool:
            return True

        def __ne__(self, _other: object) -> bool:
            return False

        __hash__ = int.__hash__

    def begin(self: WrenchDecoder, header: bytes, size: int, _crc: Any) -> None:
        whole(self, header, size, lambda _data: Matching())

    return [(WrenchDecoder, "__init__", begin)]


def _gate_open() -> list[Patch]:
    def admit(state: LimiterState, desired: Any, *_args: Any) -> tuple[LimiterState, None]:
        return structs.replace(state, position=desired, desired=desired), None

    return [(command_limiter, "admit", admit)]


def _stops_dead() -> list[Patch]:
    def brake(state: LimiterState, *_args: Any) -> LimiterState:
        return command_limiter.at_rest(state.position)

    return [(command_limiter, "brake", brake)]


def _delay_ignored() -> list[Patch]:
    def settle(session: Session, *_: int | None) -> bool:
        session.applied, session.pending = session.pending or session.applied, None
        return False

    return [(Session, "settle", settle)]


def _camera_not_late() -> list[Patch]:
    """The time from exposure to arrival is not known."""
    whole = CameraDecoder.feed

    def feed(self: CameraDecoder, data: bytes, stamp_ns: int) -> Any:
        return structs.replace(whole(self, data, stamp_ns), exposure_ns=stamp_ns)

    return [(CameraDecoder, "feed", feed)]


def _screws_anywhere() -> list[Patch]:
    """The task assumes contact as soon as the time has come."""
    whole = task_clock.elapsed

    def elapsed(before: float | None, _holds: bool, period: float) -> float | None:
        return whole(before, True, period)

    return [(task_clock, "elapsed", elapsed)]


def _not_predicted() -> list[Patch]:
    """The object is expected where it is now."""
    whole = BankClassifier.predict_positions

    def predict_positions(self: BankClassifier, state: Any, times: Any) -> Any:
        return whole(self, state, 0.0 * times)

    return [(BankClassifier, "predict_positions", predict_positions)]


def _clamp_never_opens() -> list[Patch]:
    whole = RsiLink.prepare

    def prepare(self: RsiLink, command: Any, origin: Any, digital_out: int) -> Any:
        return whole(self, command, origin, digital_out & ~RELEASE_WHEEL)

    return [(RsiLink, "prepare", prepare)]


def _hold_goes_on() -> list[Patch]:
    whole = states.order

    def order(machine: Machine) -> MotionOrder:
        return MotionOrder.TRACK if machine.state is State.HOLD else whole(machine)

    return [(states, "order", order)]


ERRORS: dict[str, Callable[[], list[Patch]]] = {
    "camera-30-mm-off": _camera_off,
    "distance-30-mm-off": _distance_off,
    "overload-never": _overload_never,
    "position-never-stale": lambda: _facts(
        position_ns=lambda f: f.stamp_ns, slower_ns=lambda f: f.stamp_ns
    ),
    "every-sample-believed": _every_sample_believed,
    "wrench-never-stale": lambda: _facts(wrench_ns=lambda f: f.stamp_ns),
    "link-never-lost": lambda: _signals(link=Link.HEALTHY),
    "wrench-crc-unchecked": _crc_unchecked,
    "coasting-3-s": lambda: _settings(position_in_contact_s=COASTING_S, wrench_s=COASTING_S),
    "following-error-never": lambda: _facts(following_error=lambda _: False),
    "gate-open": _gate_open,
    "stops-dead": _stops_dead,
    "delay-ignored": _delay_ignored,
    "camera-not-late": _camera_not_late,
    "contact-never": lambda: _facts(contact=lambda _: False),
    "screws-anywhere": _screws_anywhere,
    "not-predicted": _not_predicted,
    "clamp-never-opens": _clamp_never_opens,
    "hold-goes-on": _hold_goes_on,
    "position-stale-late": lambda: _settings(position_s=COASTING_S),
}
"""The ten that the catalogue asks for, then ten more."""


@dataclass(frozen=True, slots=True)
class Found:
    """What became of one planted error.

    Attributes:
        runs: to the first violation that the error caused; of all runs if there was none.
        violation: that one, None if there was none.
    """

    name: str
    runs: int
    violation: str | None


_SILENT = ("silence", "unplug")
_WRONG = ("stuck", "scale", "offset", "drift")
MATTERS: dict[str, dict[str, tuple[str, ...]]] = {
    "overload-never": {"force_torque": ("scale", "offset", "drift")},
    "position-never-stale": {"distance": _SILENT},
    "every-sample-believed": {"distance": _WRONG, "camera": _WRONG, "force_torque": _WRONG},
    "wrench-never-stale": {"force_torque": _SILENT},
    "link-never-lost": {"robot": ("silence", "deafness"), "reply": ("silence",)},
    "wrench-crc-unchecked": {"force_torque": ("flip", "truncate", "garbage")},
    "coasting-3-s": {"distance": _SILENT, "force_torque": _SILENT},
    "following-error-never": {"robot": ("drives_off",)},
    "delay-ignored": {"reply": ("loss", "silence", "delay"), "robot": ("deafness",)},
    "clamp-never-opens": {"operator": ("stop", "retreat"), "force_torque": (*_SILENT, "stuck")},
    "hold-goes-on": {"operator": ("stop",), "distance": _SILENT, "force_torque": _SILENT},
    "position-stale-late": {"distance": _SILENT},
}
"""Faults that an error waits for, by their link. A plan without one is counted and not run, so that
the count of runs is an upper bound; an error that is not here waits for none."""


def hunt(name: str, seeds: range, cycle_ms: CycleMs = 12) -> Found:
    """Count the runs to the first violation that a planted error causes.

    Args:
        seeds: of the plans, in order.
        cycle_ms: of the controller [ms].

    Raises:
        RuntimeError: the planted code itself does not work.
    """
    for count, seed in enumerate(seeds, 1):
        plan = dst_plan.draw(seed, cycle_ms)
        waits_for = MATTERS.get(name)
        if waits_for is not None and not any(
            fault.kind in waits_for.get(fault.link, ()) for fault in plan.faults
        ):
            continue
        with planted(name):
            violations = dst_run.run(plan).violations
        if any("TypeError" in what or "AttributeError" in what for what in violations):
            raise RuntimeError(f"{name} raises, and so finds itself: {violations[0]}")
        if violations and not dst_run.run(plan).violations:
            return Found(name, count, violations[0])
    return Found(name, len(seeds), None)


@contextlib.contextmanager
def planted(name: str) -> Iterator[None]:
    """Let one error be in the daemon."""
    with contextlib.ExitStack() as stack:
        for patch in ERRORS[name]():
            stack.enter_context(mock.patch.object(*patch))
        yield


def main(argv: Sequence[str] | None = None) -> int:
    """Hunt planted errors.

    Returns:
        0 if each was found, 1 if one was not, 2 for wrong arguments.
    """
    parser = argparse.ArgumentParser(prog="dst_planted", description="Hunt planted errors.")
    parser.add_argument("names", nargs="*", help=f"of {', '.join(ERRORS)}; all if none is given")
    parser.add_argument("--runs", type=int, default=RUNS, help="at most, for each error")
    parser.add_argument("--first", type=int, default=0, help="seed")
    parser.add_argument("--cycle-ms", type=int, choices=get_args(CycleMs), default=12)
    args = parser.parse_args(argv)
    unknown = [name for name in args.names if name not in ERRORS]
    if unknown or args.runs < 1:
        print(f"dst_planted: no such error: {', '.join(unknown) or args.runs}", file=sys.stderr)
        return 2
    seeds = range(args.first, args.first + args.runs)
    missed = 0
    for name in args.names or ERRORS:
        hunted = hunt(name, seeds, args.cycle_ms)
        missed += hunted.violation is None
        print(f"{name}: {hunted.runs} runs: {hunted.violation or 'not found'}", flush=True)
    print(f"{missed} not found within {args.runs} runs")
    return 1 if missed else 0


if __name__ == "__main__":
    sys.exit(main())
