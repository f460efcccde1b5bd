"""Each row of the state table names its cause in the journal, with the facts that decided."""

import itertools
import logging
import re
from collections.abc import Iterator
from dataclasses import fields, replace
from pathlib import Path

import pytest
from msgspec import structs

from linemate.daemon.config import config
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle import causes, watch
from linemate.daemon.cycle.operating import Situation
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.states import TABLE, Link, Machine, Row, Signals, State, deciding_row
from linemate.daemon.cycle.watch import Watch
from linemate.daemon.service.app import App
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.notify import Notifier

NOW_NS = 90_000_000_000
MS = 1_000_000
QUIET = Signals(Link.HEALTHY, True, True, True)
FLAGS = tuple(f.name for f in fields(Signals) if f.name != "link")
MOST_LOUD = 3

FACTS = {
    "position_fresh": r"camera silent for 0\.31 s, distance 0\.02 s \(limit 0\.30 s\)",
    "wrench_fresh": r"force_torque silent for 0\.20 s \(limit 0\.16 s\)",
    "ready": "the estimate of the object is not ready",
    "object_left": "leaves the reach of the linear axis or the arm",
    "contact": r"contact felt for 2 cycles, limit 2",
    "overload": r"force 400 N, limit 350 N",
    "outwaited": r"go was not given",
    "done": "the task's retreat has begun",
    "clear": "the tool is free, away and at rest",
    "expired": r"in (hold|retreat|home) for 90\.0 s, limit \d+\.0 s",
    "fault": r"following error: A1 is at 0\.5, it was sent to 0\.1 for 5 cycles, limit 5",
    "latched": r"A1 is at 0\.5",
    **{op: f"{op} ordered by alice" for op in watch.OPERATIONS},
}
"""What the journal must say of each signal; of the link see below."""

FOLLOWING = {
    "object_left": r"the arm does not reach a pose handed in\. Hand in poses within its reach",
    "clear": "no pose is left, and the robot stands behind the last one",
}
ON_THE_WAY_HOME = {
    "object_left": r"the arm does not reach a pose of the way\. Drive the robot home by hand",
    "clear": "the way home is over",
}

LINKS = {
    Link.LOST: r"no answered telegram for 0\.31 s, limit 0\.[13]0 s",
    Link.UNPROVEN: r"no answered telegram for 0\.31 s, limit 0\.(03|15) s",
    Link.HEALTHY: r"90 answered cycles in a row, 80 needed",
}


def scenes() -> Iterator[tuple[Machine, Signals, frozenset[str]]]:
    """Everything quiet but a few, the fewest first."""
    machines = [(False, False), (False, True), (True, False), (True, True)]
    for count in range(MOST_LOUD + 1):
        for (latched, programmed), link in itertools.product(machines, Link):
            loud = count - (link is not Link.HEALTHY) - latched
            if loud < 0:
                continue
            for names in itertools.combinations(FLAGS, loud):
                changed = {name: not getattr(QUIET, name) for name in names}
                present = set(names)
                present |= {"latched"} if latched else set()
                present |= {"link"} if link is not Link.HEALTHY else set()
                yield (
                    Machine(State.INIT, latched, programmed),
                    replace(QUIET, link=link, **changed),
                    frozenset(present),
                )


def scene_of(row: Row) -> tuple[Machine, Signals, frozenset[str]]:
    """The fewest things that make a row decide: each of them is its cause."""
    for there, signals, loud in scenes():
        machine = replace(there, state=row.source)
        seen = replace(machine, latched=machine.latched or signals.fault)
        if deciding_row(seen, signals) is row:
            return machine, signals, loud
    raise AssertionError(f"no signals lead to {row}")


@pytest.fixture
def app(tmp_path: Path, parameters: Parameters) -> App:
    path = tmp_path / "linemated.yaml"
    path.write_text("task: wheel.yaml\nrsi: {port: 0}\ncommand: {socket: c.sock}\n")
    return App(config.load(path), parameters, realtime.RealtimeHost(), Notifier())


def queues() -> SensorQueues:
    made = SensorQueues()
    made.distance.newest_ns, made.camera.newest_ns = NOW_NS - 20 * MS, NOW_NS - 310 * MS
    made.wrench.newest_ns = NOW_NS - 200 * MS
    made.overload_n = (400.0, 350.0)
    return made


@pytest.mark.parametrize("row", TABLE, ids=lambda row: f"{row.source}-{row.because}-{row.target}")
def test_the_journal_alone_names_the_cause_of_every_row(
    row: Row, app: App, caplog: pytest.LogCaptureFixture, monkeypatch: pytest.MonkeyPatch
) -> None:
    machine, signals, loud = scene_of(row)
    operating = app.cycle.operating
    # The older of the two position sensors decides only if it may be this old.
    operating.settings = WatchSettings(one_sensor_s=0.3, position_in_contact_s=0.3)
    counts = Watch(
        signals.link,
        NOW_NS - 310 * MS,
        good=90,
        contact=2,
        overload=1,
        following_error=5,
        state=row.source,
    )
    monkeypatch.setattr(watch, "observe", lambda *_: (counts, signals))
    operating.machine = machine
    if machine.latched:
        operating.fault = "following error: A1 is at 0.5"
    operating._orders = dict.fromkeys(watch.OPERATIONS, "alice")
    situation = Situation(None, None, "A1 is at 0.5, it was sent to 0.1", False, True)
    operating.decide(NOW_NS, queues(), situation, telegram=True)
    with caplog.at_level(logging.INFO, "linemate"):
        app._events.log_changes(NOW_NS)
    records = [record for record in caplog.records if record.name == "linemate.state"]
    (line,) = [record.getMessage() for record in records]
    assert {record.levelname for record in records} == {"INFO"}
    assert line.startswith(f"{row.source} -> {row.target}: {row.because}")
    for name in loud:
        own = {State.HOME: ON_THE_WAY_HOME, State.FOLLOW: FOLLOWING}
        facts = FACTS | own.get(row.source, {})
        expected = LINKS[signals.link] if name == "link" else facts.get(name, name)
        assert re.search(expected, line), (name, line)
    if not loud:
        assert re.search(LINKS[signals.link], line), line
    assert operating.cause == line.partition(": ")[2]


def test_two_rows_of_one_state_never_give_the_same_line(parameters: Parameters) -> None:
    lines = {(row.source, row.target, row.because) for row in TABLE}
    assert len(lines) == len(TABLE)


def evidence(**changes: object) -> causes.Evidence:
    facts = watch.Facts(NOW_NS, telegram=True)
    whole = causes.Evidence(
        facts, Watch(), WatchSettings(), queues().facts(), None, None, None, {}, None
    )
    return structs.replace(whole, **changes)  # type: ignore[arg-type]


def test_what_is_named_is_enough_for_the_row_whatever_else_is_the_case() -> None:
    seen = 0
    for state, link in itertools.product(State, Link):
        for n in range(0, 1 << len(FLAGS), 397):
            signals = Signals(link, *(bool(n >> bit & 1) for bit in range(len(FLAGS))))
            machine = Machine(state, latched=signals.fault or n % 2 == 0)
            row = deciding_row(machine, signals)
            if row is None:
                continue
            seen += 1
            names = causes.decisive(row, machine, signals)
            assert names
            loud = [n for n in names if n == "latched" or getattr(signals, n) != getattr(QUIET, n)]
            only = {n: getattr(signals, n) for n in loud if n != "latched"}
            quieter = replace(machine, latched="latched" in loud)
            assert deciding_row(quieter, replace(QUIET, **only)) is row, (row, names)
            for name in loud:
                fewer = {n: value for n, value in only.items() if n != name}
                unlatched = replace(quieter, latched=quieter.latched and name != "latched")
                others = deciding_row(unlatched, replace(QUIET, **fewer)) is row
                # One of several that would do each by itself.
                assert not others or len(loud) > 1, (row, names)
    assert seen > 250


@pytest.mark.parametrize("link", [Link.LOST, Link.UNPROVEN])
def test_a_controller_that_takes_no_setpoints_is_the_cause_and_not_the_network(link: Link) -> None:
    known = evidence(declined="the controller takes no setpoints: emergency stop. Release it.")
    words, advice = causes._link(replace(QUIET, link=link), known)
    assert words.startswith("no answered telegram")
    assert advice == "The controller takes no setpoints: emergency stop. Release it."


@pytest.mark.parametrize(
    ("change", "lines"),
    [
        ({"new_session": True}, "the controller's programme began again. Arm and start again."),
        ({}, "no answered telegram since the start, limit 0.10 s. Check the robot's network"),
    ],
)
def test_a_new_program_and_a_silent_line_have_different_causes(
    change: dict[str, bool], lines: str
) -> None:
    lost = replace(QUIET, link=Link.LOST)
    row = deciding_row(Machine(State.TRACK), lost)
    assert row is not None
    facts = watch.Facts(NOW_NS, telegram=False, **change)  # type: ignore[arg-type]
    assert lines in causes.cause(row, Machine(State.TRACK), lost, evidence(facts=facts))


def test_an_excluded_sensor_is_named_with_what_it_was_excluded_for() -> None:
    stale = replace(QUIET, position_fresh=False)
    row = deciding_row(Machine(State.TRACK), stale)
    assert row is not None
    broken = queues()
    broken.camera_health.exclude(NOW_NS, "4 poses alike")
    text = causes.cause(row, Machine(State.TRACK), stale, evidence(sensors=broken.facts()))
    assert "camera excluded (4 poses alike) for 0.31 s" in text
    assert "Check the link of" in text


def test_a_distance_that_is_lost_in_the_last_approach_is_no_contradiction_of_the_camera() -> None:
    samples = queues()
    samples.distance_health.exclude(NOW_NS, "it jumped by 0.013 m")
    facts = watch.Facts(NOW_NS, telegram=True, distance_lost=True)
    stale = replace(QUIET, position_fresh=False)
    row = deciding_row(Machine(State.TRACK), stale)
    assert row is not None
    known = evidence(sensors=samples.facts(), facts=facts)
    text = causes.cause(row, Machine(State.TRACK), stale, known)
    assert "distance excluded (it jumped by 0.013 m) for 0.02 s" in text
    assert "camera" not in text


def test_a_latched_fault_is_reported_at_once_and_again_where_it_leads(app: App) -> None:
    operating, situation = app.cycle.operating, Situation(None, None, None, False, True)
    operating.machine = Machine(State.RETREAT)
    operating._watch = Watch(Link.HEALTHY, NOW_NS, state=State.RETREAT, since_ns=NOW_NS)
    operating.has_failed = True
    operating.decide(NOW_NS, SensorQueues(), situation, telegram=True)
    operating.decide(NOW_NS + 3000 * MS, SensorQueues(), situation, telegram=False)
    first, second = map(str, operating.take_changes())
    failed = "the daemon failed in a cycle. Read the error in the journal."
    assert first == f"retreat -> retreat: latched: {failed}"
    assert second.startswith("retreat -> fault: robot link lost in motion: no answered telegram")
    assert operating.fault == failed


def test_a_state_that_does_not_change_says_nothing(app: App) -> None:
    situation = Situation(None, None, None, False, True)
    for n in range(20):
        app.cycle.operating.decide(NOW_NS + n * 12 * MS, SensorQueues(), situation, telegram=False)
    assert app.cycle.take_changes() == []


def test_a_force_that_answers_no_motion_is_the_cause_that_is_named() -> None:
    words, todo = causes._overload(Signals(Link.HEALTHY), evidence(unanswered_n=120.0))
    assert words == "a force of 120 N answered no motion of the tool in contact"
    assert todo == "Check the sign and the axes of the force-torque sensor."


@pytest.mark.parametrize(("state", "holds"), [(State.CONTACT, True), (State.TRACK, False)])
def test_an_overload_in_contact_names_what_holds_the_object(state: State, holds: bool) -> None:
    known = evidence(counts=Watch(Link.HEALTHY, NOW_NS, state=state))
    _, todo = causes._overload(Signals(Link.HEALTHY), known)
    assert ("tracking.tactile.holds" in todo) is holds


def test_a_robot_that_got_no_setpoints_is_the_cause_that_is_named() -> None:
    known = evidence(
        facts=watch.Facts(NOW_NS, True, unled_s=0.08),
        counts=Watch(Link.UNPROVEN, NOW_NS, good=1, state=State.TRACK),
    )
    words, _ = causes._link(Signals(Link.UNPROVEN), known)
    assert words == "the robot got no setpoint for 0.080 s, limit 0.055 s"
