"""FANUC and EGM in the fault campaign: whole runs, what is left out, and what is judged."""

from itertools import count
from typing import Any

import pytest

from linemate.protocol.egm.egm_link import EgmLink
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.simulators.lab.faults import dst_plan, dst_run
from linemate.simulators.lab.faults.dst_controllers import StrictFamily, build
from linemate.simulators.lab.faults.dst_plan import FAMILY_CYCLES_MS, FaultPlan, draw
from linemate.simulators.lab.faults.dst_run import Simulation
from linemate.simulators.plants.scenario import Fault

CELLS = sorted(FAMILY_CYCLES_MS)


def plan_of(cell: str, *faults: Fault, duration_s: float = 1.9) -> FaultPlan:
    cycle_ms = FAMILY_CYCLES_MS[cell]
    return FaultPlan(1, duration_s=duration_s, cell=cell, cycle_ms=cycle_ms, faults=faults)


@pytest.mark.parametrize("cell", CELLS)
def test_without_trouble_the_wheel_is_on_the_hub_and_every_telegram_answered(cell: str) -> None:
    simulation = Simulation(plan_of(cell, duration_s=3.0))
    simulation.live()
    assert simulation.outcome().violations == ()
    counts = simulation.controller.counts
    assert counts.answered == counts.sent - 1 > 400
    assert simulation.world.released_s is not None


@pytest.mark.row
@pytest.mark.parametrize("cell", CELLS)
@pytest.mark.parametrize("seed", [3, 6])
def test_a_seed_runs_without_a_violation(cell: str, seed: int) -> None:
    assert dst_run.run(draw(seed, cell=cell)).violations == ()


@pytest.mark.parametrize("cell", CELLS)
def test_a_family_draws_its_own_cell_and_no_fault_that_has_no_meaning_for_it(cell: str) -> None:
    plans = [draw(seed, cell=cell) for seed in range(1000)]
    assert {(plan.cell, plan.cycle_ms) for plan in plans} == {(cell, FAMILY_CYCLES_MS[cell])}
    kinds = {fault.kind for plan in plans for fault in plan.faults}
    assert not kinds & dst_plan.MEANINGLESS[cell]
    assert {"loss", "ipoc_jump", "restart", "crash", "drives_off", "deafness"} <= kinds


@pytest.mark.parametrize(("cell", "link"), [("egm", EgmLink), ("fanuc", FanucLink)])
def test_a_setpoint_beyond_a_limit_is_a_violation(
    monkeypatch: pytest.MonkeyPatch, cell: str, link: type[EgmLink] | type[FanucLink]
) -> None:
    prepare = link.prepare

    calls = count(1)

    def kicked(own: Any, command: tuple[float, ...], *others: Any) -> Any:
        a1, *axes = command
        return prepare(own, (a1 + 4e-3 * (next(calls) % 100 == 0), *axes), *others)

    monkeypatch.setattr(link, "prepare", kicked)
    (first, *_) = dst_run.run(plan_of(cell)).violations
    assert first.startswith("refused: limit" if cell == "fanuc" else "limits:")


def test_a_refusal_is_the_daemons_own_doing_unless_a_reply_was_lost_on_the_network() -> None:
    blamed: list[str] = []
    plan = plan_of("fanuc", Fault(1.0, "reply", "loss", 0.1, 0.5))
    controller = build(plan, lambda: None, (0.0,) * 7)  # type: ignore[arg-type, return-value]
    strict = StrictFamily(controller, plan, blamed.append)
    for now_s, most in ((1.05, 0), (1.15, 0), (1.25, 1)):
        controller.refusals["limit"] += 1
        strict.judge_reply(now_s)
        assert len(blamed) == most
    controller.refusals["not_ready"] += 1
    strict.judge_reply(2.0)
    assert len(blamed) == 1
