"""A short share of the fault campaign, past failures, and planted errors."""

import json
import logging
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.operating import Operating
from linemate.daemon.cycle.session import Session
from linemate.daemon.cycle.states import Link, Machine, Signals, State
from linemate.simulators.harness.virtual.virtual_time import VirtualTime
from linemate.simulators.lab.faults import dst, dst_oracles, dst_plan, dst_run
from linemate.simulators.lab.faults.dst_plan import FaultPlan, draw
from linemate.simulators.plants.conveyor_plan import ConveyorEvent
from linemate.simulators.plants.scenario import Fault

REGRESSIONS = Path(__file__).parent / "regressions.txt"
FIT = Signals(link=Link.HEALTHY, position_fresh=True, wrench_fresh=True, ready=True)
LOSSY = FaultPlan(1, faults=(Fault(0.3, "reply", "loss", 0.9, 0.3),))


def regressions() -> list[str]:
    lines = REGRESSIONS.read_text(encoding="utf-8").splitlines()
    return [line for line in lines if line and not line.startswith("#")]


@pytest.mark.row
@pytest.mark.parametrize("seed", [0, 2, 3, 6, 7, 10])
def test_a_seed_runs_without_a_violation(seed: int) -> None:
    assert dst_run.run(draw(seed)).violations == ()


@pytest.mark.row
@pytest.mark.parametrize("seed", [1, 3, 5, 7])
def test_a_seed_runs_at_4_ms_without_a_violation(seed: int) -> None:
    assert dst_run.run(draw(seed, cycle_ms=4)).violations == ()


@pytest.mark.row
@pytest.mark.parametrize("line", regressions())
def test_what_once_failed_does_not_fail_again(line: str) -> None:
    assert dst_run.run(dst_plan.from_line(line)).violations == ()


def test_one_plan_leaves_one_trace_whatever_the_process_and_its_hash_seed() -> None:
    plan = draw(3)
    here = dst_run.run(plan).digest
    done = subprocess.run(
        [sys.executable, "-m", "linemate.simulators.lab.faults.dst", "--trace", "3"],
        env={**os.environ, "PYTHONHASHSEED": "12345"},
        capture_output=True,
        text=True,
        check=True,
    )
    assert done.stdout.split() == ["3", here]
    assert dst_run.run(replace(plan, seed=4)).digest != here


@pytest.mark.row
@pytest.mark.parametrize("seed", [2, 3, 7])
def test_ports_that_tell_when_they_are_filled_are_as_good_as_asked_every_time(
    monkeypatch: pytest.MonkeyPatch, seed: int
) -> None:
    class Asking(VirtualTime):
        def __init__(self, *args: int) -> None:
            super().__init__(*args)
            self.unplugged.add("something that no one watches")

    digest = dst_run.run(draw(seed)).digest
    monkeypatch.setattr(dst_run, "VirtualTime", Asking)
    assert dst_run.run(draw(seed)).digest == digest


def test_without_trouble_the_wheel_is_on_the_hub_and_every_telegram_answered() -> None:
    simulation = dst_run.Simulation(FaultPlan(0, duration_s=3.0))
    simulation.live()
    assert simulation.outcome().violations == ()
    counts = simulation.controller.counts
    # The last cycle is still open.
    assert counts.answered == counts.sent - 1 > 200
    assert counts.late == counts.lost == counts.refused == 0
    assert simulation.world.released_s is not None
    assert simulation.world.collision is None
    assert simulation.oracle.states >= {"init", "idle", "armed", "track", "contact", "retreat"}


def test_a_plan_is_one_line_and_comes_back_from_it() -> None:
    for seed in range(40):
        plan = draw(seed)
        assert "\n" not in plan.to_line()
        assert dst_plan.from_line(plan.to_line()) == plan


def test_half_of_the_seeds_are_calm_and_the_others_reach_every_kind_of_fault() -> None:
    plans = [draw(seed) for seed in range(2000)]
    assert all(not plan.faults for plan in plans[::4])
    assert all(len(plan.faults) == 1 for plan in plans[1::4])
    from linemate.simulators.devices.faults import KINDS

    seen = {(fault.link, fault.kind) for plan in plans for fault in plan.faults}
    assert seen == {(link, kind) for link, kinds in KINDS.items() for kind in kinds}
    assert all(dst_run.LEAD_IN_S + plan.duration_s >= 2.0 for plan in plans)


# The campaign notices planted errors.


@pytest.mark.parametrize(
    ("sent", "heard", "quiet_s", "is_blamed"),
    [
        # At 0.5 rad/s or at rest when the motion ends; braking takes 0.5 s and jerking 0.4 s.
        (0.5, True, 0.85, False),
        (0.5, True, 0.95, True),
        (0.0, True, 0.35, False),
        (0.0, True, 0.45, True),
        # A robot that was deaf is sent 0.5 rad/s from where it stands, again and again.
        (0.5, False, 0.85, False),
        (0.5, False, 0.95, True),
    ],
)
def test_motion_that_outlasts_its_braking_is_a_violation(
    sent: float, heard: bool, quiet_s: float, is_blamed: bool
) -> None:
    oracle, cycle_s = dst_oracles.FaultOracle(0.012, (1.0,) * 7), 0.012
    held, command = (0.0,) * 7, (0.0,) * 7
    oracle.holds = lambda: held

    def step(state: str) -> None:
        outputs = SimpleNamespace(
            command=command, target=None, sensed=None, part=None, speed=None, events=()
        )
        oracle._judge_step(SimpleNamespace(outputs=outputs, state=state), 1)  # type: ignore[arg-type]

    for _ in range(20):
        command = tuple(q + sent * cycle_s for q in held)
        step("track")
        held = command if heard else held
    held = command
    for _ in range(round(quiet_s / cycle_s)):
        command = tuple(q + 0.3 * cycle_s for q in held)
        step("idle")
        held = command
    assert bool(oracle.violations) is is_blamed


def test_a_daemon_that_does_not_look_at_delay_breaks_the_limits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    assert dst_run.run(LOSSY).violations == ()

    def settle(session: Session, *_: int | None) -> bool:
        session.applied, session.pending = session.pending or session.applied, None
        return False

    monkeypatch.setattr(Session, "settle", settle)
    assert any(what.startswith("limits:") for what in dst_run.run(LOSSY).violations)


def test_an_exception_in_the_daemon_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    def decide(_: Operating, stamp_ns: int, *_facts: object, telegram: bool) -> None:
        raise ZeroDivisionError(f"{stamp_ns} {telegram}")

    monkeypatch.setattr(Operating, "decide", decide)
    violations = dst_run.run(FaultPlan(1)).violations
    assert any("faults: fault 1 in the cycle ZeroDivisionError" in what for what in violations)


def test_a_run_that_does_not_end_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(dst_run.Simulation, "_boot", lambda _: None)
    monkeypatch.setattr(dst_run, "LONGEST_S", 0.5)
    (what,) = dst_run.run(FaultPlan(1)).violations
    assert what.startswith("liveness: the run does not end")


def test_an_operators_order_that_gets_lost_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Cycle, "order", lambda _cycle, _op, _who="": None)
    violations = dst_run.run(FaultPlan(1)).violations
    assert any(what.startswith("order: arm was accepted and lost") for what in violations)


def test_a_daemon_that_cannot_begin_again_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Cycle, "order", lambda _cycle, _op, _who="": "not today")
    plan = FaultPlan(1, faults=(Fault(0.1, "camera", "loss", 0.1, 0.5),))
    assert dst_run.run(plan).violations[0].startswith("liveness: idle")


def test_a_daemon_that_talks_too_much_is_a_violation(monkeypatch: pytest.MonkeyPatch) -> None:
    decide = Operating.decide

    def chatty(operating: Operating, *facts: Any, telegram: bool) -> None:
        logging.getLogger("linemate.daemon").warning("a decision")
        decide(operating, *facts, telegram=telegram)

    monkeypatch.setattr(Operating, "decide", chatty)
    assert any(what.startswith("log: ") for what in dst_run.run(FaultPlan(1)).violations)


@pytest.mark.parametrize(("ahead", "is_blamed"), [(29, False), (31, True)])
def test_a_clock_that_races_is_a_violation(ahead: int, is_blamed: bool) -> None:
    oracle = dst_oracles.FaultOracle(0.012, (1.0,) * 7)
    for number in range(1, 100):
        steps = number + (ahead if number > 50 else 0)
        cycle: Any = SimpleNamespace(machine=Machine(), log_dropped=0, steps=steps)
        oracle.judge_cycle(cycle, 0.012 * number)
    assert any(what.startswith("clock: ") for what in oracle.violations) is is_blamed


@pytest.mark.parametrize(
    ("end_s", "state"), [(0.15, "hold stopped"), (0.95, "retreat stopped in contact")]
)
def test_an_end_in_motion_holds_far_from_the_object_and_retreats_near_it(
    end_s: float, state: str
) -> None:
    simulation = dst_run.Simulation(FaultPlan(8, duration_s=end_s))
    simulation.live()
    assert simulation.outcome().violations == ()
    assert any(line.endswith(state) for line in simulation.oracle.story)
    assert simulation.world.collision is None


@pytest.mark.parametrize(
    ("name", "before", "signals", "after"),
    [
        ("I2", Machine(State.FAULT, latched=True), FIT, Machine(State.IDLE)),
        ("I3", Machine(State.ARMED), FIT, Machine(State.TRACK)),
        ("I3", Machine(State.RETREAT), replace(FIT, start=True), Machine(State.TRACK)),
        ("I4", Machine(State.CONTACT), FIT, Machine(State.HOLD)),
        ("I5", Machine(State.TRACK), replace(FIT, link=Link.LOST), Machine(State.HOLD)),
        ("I6", Machine(State.HOLD, latched=True), FIT, Machine(State.HOLD)),
        ("I6", Machine(State.HOLD), replace(FIT, fault=True), Machine(State.HOLD)),
        ("I11", Machine(State.HOLD), replace(FIT, contact=True), Machine(State.CONTACT)),
        ("I12", Machine(State.IDLE), FIT, Machine(State.ARMED)),
        ("I13", Machine(State.TRACK), replace(FIT, retreat=True), Machine(State.CONTACT)),
        ("I13", Machine(State.TRACK), replace(FIT, stop=True), Machine(State.TRACK)),
    ],
)
def test_an_oracle_tells_a_wrong_transition(
    name: str, before: Machine, signals: Signals, after: Machine
) -> None:
    broken = {n for n, holds in dst_oracles.invariants(before, signals, after) if not holds}
    assert name in broken


# Shrinking and the command.


def outcome(plan: FaultPlan, *violations: str, force_n: float = 0.0) -> dst_run.RunOutcome:
    """What a run of a plan might have come to."""
    return dst_run.RunOutcome(plan, violations, f"{plan.seed}", 1, frozenset(), force_n)


def test_shrinking_leaves_the_one_fault_that_matters(monkeypatch: pytest.MonkeyPatch) -> None:
    guilty = Fault(1.0, "camera", "flip", 0.1, 0.5)
    others = tuple(Fault(0.1 * i, "distance", "loss", 0.1, 0.5) for i in range(5))
    plan = FaultPlan(
        9,
        duration_s=3.0,
        lead_ms=3.0,
        eager=True,
        events=(ConveyorEvent("stop", 1.0, 0.1),),
        faults=(*others[:3], guilty, *others[3:]),
    )

    def live(plan: FaultPlan) -> dst_run.RunOutcome:
        return outcome(plan, "limits: of axis 3" if guilty in plan.faults else "order: lost")

    monkeypatch.setattr(dst, "_live", live)
    assert dst.shrink(plan, "limits") == FaultPlan(
        9, duration_s=dst_plan.SHORTEST_S, faults=(guilty,)
    )


def test_a_plan_that_failed_is_kept_once_for_each_kind(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(dst, "_live", lambda plan: outcome(plan, "limits: far too fast"))
    monkeypatch.setattr(dst, "_different", lambda _traces, _cycle_ms: iter(()))
    path = tmp_path / "kept.txt"
    assert dst.main(["1:4", "--workers", "1", "--keep", str(path)]) == 1
    comment, line = path.read_text(encoding="utf-8").splitlines()
    assert comment == "# limits: far too fast"
    assert dst_plan.from_line(line).faults == ()
    assert capsys.readouterr().out.splitlines()[-1] == "3 runs, 3 violations"


def test_the_last_line_counts_the_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert dst.main(["1:2", "--workers", "1", "--forget"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "1 runs, 0 violations"


def test_every_cycle_and_cell_is_counted_for_itself(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def live(plan: FaultPlan) -> dst_run.RunOutcome:
        failed = plan.cell == "egm" and plan.seed == 2
        return outcome(plan, *(["force: 210 N"] if failed else []), force_n=100.0 + plan.seed)

    monkeypatch.setattr(dst, "_live", live)
    assert dst.main(["1:3", "--workers", "1", "--forget", "--every", "--json"]) == 1
    campaigns = json.loads(capsys.readouterr().out)["campaigns"]
    assert [(each["cell"], each["cycle_ms"]) for each in campaigns] == [
        ("drawn", 12),
        ("drawn", 4),
        *((cell, 12) for cell in (*dst_plan.CELLS, dst_plan.OTHER_LINE)),
        ("fanuc", 8),
        ("egm", 4),
    ]
    *others, egm = campaigns
    assert all(each["runs"] == 2 and each["force_n"] == 102.0 for each in others)
    assert not any(each["violations"] for each in others)
    assert egm["violations"] == [{"seed": 2, "what": ["force: 210 N"]}]
    assert egm["force_n"] == 101.0


def test_the_largest_force_of_a_run_is_that_of_a_clamped_tool() -> None:
    assert 30.0 < dst_run.run(FaultPlan(1, duration_s=1.9)).force_n < 200.0
    # A second before the touch nothing is clamped.
    short = FaultPlan(1, duration_s=0.3)
    assert dst_run.run(short).force_n == 0.0


@pytest.mark.parametrize("text", ["", "5", "5:5", "7:3", "a:b", "0:99999999999"])
def test_seeds_that_are_none_are_refused(text: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert dst.main([text]) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err.startswith("dst: ")
