"""Random parameters in motion: whatever an operator sets, limits hold and nothing is half taken.

A share of it runs with the tests; ``LINEMATE_RANDOM_SETS=10000`` runs the whole.
"""

import asyncio
import math
import os
import random
from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from linemate.daemon.config import config
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.parameter_list import ChangeTime, change_rule
from linemate.daemon.config.settings_tree import SettingError
from linemate.daemon.cycle.states import MOVING
from linemate.daemon.service.parameter_service import ParameterService
from linemate.simulators.devices.limit_judge import LIMITS
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge

SETS = int(os.environ.get("LINEMATE_RANDOM_SETS", "200"))
BEFORE = 20
"""Before the robot first moves."""

COMPILED = 4
"""Of a run: each takes a tenth of a second."""

MOST = min(2000, SETS // 2)
"""Of a run: one a cycle, and never all in one: a run that is long in contact refuses most."""

OVERRIDES = ("scenario.lead_in_s=1.5",)
WRONG: tuple[Any, ...] = (
    -1.0, 0.0, 0, -3, 1e308, 5e-324, "", "no", "1.0", None, True, False, [], [1.0], [1.0, 2.0, 3.0],
    [0.0, -1.0, "x"], 2**70, "bank", "imm",
)  # fmt: skip


def draw(rng: random.Random, known: dict[str, Any]) -> dict[str, Any]:
    """One to four changes: mostly sensible, some wild, some nonsense; most of them live."""
    live = rng.random() < 0.75
    names = sorted(n for n in known if not live or change_rule(n).change is ChangeTime.LIVE)
    names = rng.sample(names, rng.choice((1, 1, 1, 2, 4)))
    if rng.random() < 0.03:
        names.append(rng.choice(("tracking", "nonsense", "tracking.distance", "control.servos.8")))
    return {name: value(rng, known.get(name)) for name in names}


def value(rng: random.Random, usual: Any) -> Any:
    kind = rng.random()
    if kind < 0.12:
        return rng.choice(WRONG)
    if isinstance(usual, list):
        return [value(rng, item) for item in usual]
    if isinstance(usual, bool) or not isinstance(usual, (int, float)):
        return rng.choice((True, False)) if isinstance(usual, bool) else usual
    factor = rng.lognormvariate(0.0, 0.3) if kind < 0.8 else 10.0 ** rng.uniform(-4.0, 4.0)
    return max(1, round(usual * factor)) if isinstance(usual, int) else usual * factor


def robots_limits() -> str:
    """The robot's limits, which the run is judged by, as a site copies them."""
    rows = [
        f"{{lower: {robot.low}, upper: {robot.high}, speed: {min(robot.speed, own.speed)},"
        f" acceleration: {own.acceleration}, jerk: {own.jerk}}}"
        for robot, own in zip(LIMITS, setup.shipped_control().limits, strict=True)
    ]
    return f"control: {{limits: [{', '.join(rows)}]}}\n"


def needs_compiler(values: dict[str, Any]) -> bool:
    return any(change_rule(name).change is ChangeTime.IDLE for name in values)


class Operator:
    """Sets parameters while a run goes on, and holds each answer to the rules."""

    def __init__(self, station: config.LoadedConfig, run: lockstep.Lockstep, seed: int) -> None:
        self.outcomes: Counter[str] = Counter()
        self._run = run
        self._service = ParameterService(station, run.cycle)
        self._rng = random.Random(seed)
        # The limits are what the run is judged by: they stay. A watch that is set to nonsense
        # holds the robot, rightly, and then nothing moves: it comes seldom.
        self._known = {
            name: usual
            for name, usual in tree.leaves(self._service.settings)
            if not name.startswith(("control.limits.", "watch."))
        } | {"rsi.cycle_ms": 12, "watch.leak_s": 0.11}
        self._compiled = 0

    async def set(self) -> None:
        """Make one random change."""
        service, values = self._service, draw(self._rng, self._known)
        while self._run.cycle.stands and self._compiled >= COMPILED and needs_compiler(values):
            values = draw(self._rng, self._known)
        before = service.settings
        self.outcomes["moving"] += self._run.cycle.machine.state in MOVING
        answer = service.set(values, "random")
        if isinstance(answer, asyncio.Future):
            self._compiled += 1
            answer = await answer
        refused = answer.get("refused")
        self.outcomes["refused" if refused else "changed"] += 1
        if refused is not None:
            assert len(refused) > 10, values
            assert service.settings is before
            return
        try:
            whole = tree.change(before, values)
        except SettingError as error:
            pytest.fail(f"taken although it does not fit: {error}")
        assert service.settings == whole
        assert set(answer["changed"]) <= set(values)

    def check(self) -> None:
        """After a cycle: what is in force is what was answered, in one piece."""
        made = self._run.cycle.parameters
        assert made.tracker.settings == self._service.settings.tracking
        assert made.settings == self._service.settings.control
        last = self._run.cycle.last
        if last is not None:
            assert all(map(math.isfinite, last.outputs.command))


def run_once(folder: Path, seed: int, sets: int) -> Counter[str]:
    """One run with so many sets, or as many as it lives; what became of them."""

    async def main() -> Counter[str]:
        path = folder / "linemated.yaml"
        path.write_text("task: wheel.yaml\n" + robots_limits())
        station = config.load(path)
        made = setup.make("wheel", OVERRIDES)
        made = replace(made, tracking=station.config.tracking, control=station.config.control)
        run = lockstep.Lockstep(made, seed)
        operator = Operator(station, run, seed)
        turns = round((1.5 + made.scenario.duration_s) / made.scenario.cycle_s)
        done, has_moved = 0, False
        # What is set may lead the tool off its path: a run ends early where it meets the object.
        for turn in range(turns):
            if not run.turn():
                break
            if turn:
                operator.check()
            state = run.cycle.machine.state
            most = BEFORE if state not in MOVING and not has_moved else sets
            has_moved = has_moved or state in MOVING
            while done < most and done * turns < turn * sets:
                await operator.set()
                done += 1
        assert operator.outcomes["changed"] + operator.outcomes["refused"] == done
        result = judge(run.evidence())
        assert result["limits"]["violations"] == 0, (seed, result)
        assert result["telegrams"]["lost"] == result["telegrams"]["refused"] == 0
        return operator.outcomes

    return asyncio.run(main())


def test_random_parameters_in_motion_leave_no_limit_and_are_taken_whole_or_not_at_all(
    tmp_path: Path,
) -> None:
    total: Counter[str] = Counter()
    seed = 0
    while total["changed"] + total["refused"] < SETS:
        left = SETS - total["changed"] - total["refused"]
        total += run_once(tmp_path, seed, min(left, MOST))
        seed += 1
    assert total["changed"] > 0.3 * SETS
    assert total["refused"] > 0.2 * SETS
    assert total["moving"] > 0.2 * SETS
