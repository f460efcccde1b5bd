"""An exception in the k-th call of everything that a cycle calls: none takes the daemon down.

Virtual time, the whole daemon. What was planted is counted, the robot stays within its limits,
the daemon ends up holding, drawing back or at rest with the fault latched, and can begin again.
"""

from collections.abc import Callable
from typing import Any

import pytest

from linemate.daemon.core import step as stepping
from linemate.daemon.cycle import operating, states, watch
from linemate.daemon.cycle.operating import Operating
from linemate.daemon.cycle.sensing.samples import SensorQueues
from linemate.daemon.cycle.session import Session
from linemate.daemon.cycle.steps import FollowingCheck
from linemate.protocol.exchange import Exchange
from linemate.protocol.rsi.rsi_link import RsiLink
from linemate.protocol.rsi.telegram_reader import RobotReader
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.lab.faults.dst_run import Simulation

CALLED: tuple[tuple[Any, str], ...] = (
    (RobotReader, "parse"),
    (Exchange, "on_telegram"),
    (Session, "settle"),
    (Session, "note_reply"),
    (SensorQueues, "drain"),
    (FollowingCheck, "check_moving"),
    (FollowingCheck, "add_command"),
    (RsiLink, "prepare"),
    (Operating, "_facts"),
    (watch, "observe"),
    (states, "transition"),
    (states, "order"),
    (operating, "gap_after_stop"),
    (stepping, "plan"),
    (stepping, "finish"),
)
SAFE = {"hold", "retreat", "fault", "idle", "init"}
FREE_S, CONTACT_S = -0.05, 1.3


class PlantedError(Exception):
    """No one in the daemon knows of it."""


def plant(
    simulation: Simulation, what: tuple[Any, str], at_s: float, patch: pytest.MonkeyPatch
) -> list[float]:
    """Let one call of something raise, the first at a time or after it."""
    owner, name = what
    whole: Callable[..., Any] = getattr(owner, name)
    raised: list[float] = []

    def broken(*args: Any, **options: Any) -> Any:
        if simulation.now_s >= at_s and not raised:
            raised.append(simulation.now_s)
            raise PlantedError(name)
        return whole(*args, **options)

    patch.setattr(owner, name, broken)
    return raised


@pytest.mark.parametrize(("at_s", "lead_ms"), [(FREE_S, 3.0), (CONTACT_S, 0.0)])
@pytest.mark.parametrize("what", CALLED, ids=[name for _, name in CALLED])
def test_an_exception_anywhere_in_a_cycle_ends_the_motion_and_not_the_daemon(
    what: tuple[Any, str], at_s: float, lead_ms: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    simulation = Simulation(FaultPlan(0, duration_s=at_s + 0.25, lead_ms=lead_ms))
    raised = plant(simulation, what, at_s, monkeypatch)
    seen: list[tuple[float, str]] = []
    look = simulation._judge_cycle

    def looking() -> None:
        look()
        if simulation.app is not None:
            seen.append((simulation.now_s, simulation.app.cycle.machine.state.value))

    monkeypatch.setattr(simulation, "_judge_cycle", looking)
    simulation.live()
    if not raised:
        # A gap is of no interest in contact.
        assert (what[1], at_s) == ("gap_after_stop", CONTACT_S)
        return
    # It is counted, and that is all that any oracle has to say. A reply that went out in haste,
    # before its telegram was judged, is one that its telegram then did not get.
    for violation in simulation.outcome().violations:
        assert violation.startswith(("exception: 1 faults", "exception: 1 hasty"))
    assert simulation.world.collision is None
    after = [state for now_s, state in seen if now_s > raised[0] + 0.1]
    assert after
    assert set(after) <= SAFE


@pytest.mark.parametrize("at_s", [1.15, 1.3, 1.6])
def test_an_exception_between_a_step_and_its_reply_dates_no_measurement_wrong(
    at_s: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A second step with the stamp of the first took 1.3 mm of the line for a push of the body.
    simulation = Simulation(FaultPlan(1, duration_s=at_s + 0.6))
    raised = plant(simulation, (FollowingCheck, "add_command"), at_s, monkeypatch)
    simulation.live()
    assert raised
    assert all(each.startswith("exception: ") for each in simulation.outcome().violations)
