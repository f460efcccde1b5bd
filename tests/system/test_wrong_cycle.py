"""A controller whose cycle is not the configured one: the whole daemon in virtual time.

The plan's cycle is the controller's and the plant's; the daemon is configured with 12 ms.
"""

from typing import Any

import pytest

from linemate.daemon.cycle.clock import phase_lock
from linemate.daemon.service.app import App
from linemate.daemon.service.host.notify import Notifier
from linemate.daemon.service.host.realtime import RealtimeHost
from linemate.simulators.harness.virtual.virtual_time import EPOCH_NS
from linemate.simulators.lab.faults import dst_run
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.plants.scenario import Fault

CONFIGURED_MS = 12


class Mismatched(dst_run.Simulation):
    """A run whose daemon believes in 12 ms."""

    def _boot(self) -> None:
        assert self._loop is not None
        station = dst_run.station_of(self.plan.lead_ms, CONFIGURED_MS)
        compiled = dst_run.compiled(CONFIGURED_MS * 1e-3)
        self.app = app = App(station, compiled, RealtimeHost(), Notifier())
        self.oracle.attend(app.cycle)
        self._process = self._loop.create_task(app.run())
        self._process.add_done_callback(self._ended)

    def _goes_on(self, app: App | None) -> bool:
        return self.now_s < self.plan.duration_s


def lived(share: float, jitter_s: float = 0.0) -> Mismatched:
    """Run an operator who orders arm and start again and again."""
    run = Mismatched(planned(share, jitter_s))
    run.live()
    return run


def planned(share: float, jitter_s: float = 0.0) -> FaultPlan:
    cycle_ms: Any = round(CONFIGURED_MS * share, 4)
    faults = (Fault(-0.5, "robot", "jitter", 5.0, jitter_s),) if jitter_s else ()
    return FaultPlan(1, duration_s=2.0, eager=True, faults=faults, cycle_ms=cycle_ms)


@pytest.mark.parametrize("jitter_s", [0.0, 0.002])
@pytest.mark.parametrize("share", [0.9, 0.925, 1.07, 1.08])
def test_a_controller_more_than_5_per_cent_off_is_never_armed(
    share: float, jitter_s: float
) -> None:
    run = lived(share, jitter_s)
    assert not {"armed", "track", "contact"} & set(run.oracle.states)
    assert not run.oracle.violations
    assert "the controller's cycle is" in run.operator.refusal


@pytest.mark.parametrize("share", [0.97, 1.0, 1.03])
def test_a_controller_within_5_per_cent_is_armed(share: float) -> None:
    assert "track" in lived(share).oracle.states


def test_a_motion_at_a_wrong_cycle_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    """The controller is 4 % off; from the middle of the approach on, 3 % is the limit."""
    run = Mismatched(planned(1.04))
    middle_ns = EPOCH_NS + round((dst_run.LEAD_IN_S + 0.1) * 1e9)
    run._time.at(middle_ns, lambda: monkeypatch.setattr(phase_lock, "TOLERANCE", 0.03))
    run.live()
    assert {"track", "hold"} <= set(run.oracle.states)
    assert "contact" not in run.oracle.states
    assert not run.oracle.violations
