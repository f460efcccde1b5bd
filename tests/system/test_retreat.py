"""Emergency retreats with the tool clamped, judged by the plant's own force and collision."""

import pytest
from contact_runs import live

from linemate.daemon.cycle.states import CLAMP_CLOSED, State
from linemate.simulators.plants.scenario import Fault

BEARABLE_N = 100.0
NEVER_S = 1e4
SENSORS = ("distance", "camera", "force_torque")


def silent(at_s: float, *links: str) -> tuple[Fault, ...]:
    return tuple(Fault(at_s, link, "silence", 20.0) for link in links)


@pytest.mark.parametrize("release_s", [0.1, 0.3, 1.0])
def test_a_retreat_without_force_waits_until_the_clamp_is_open(release_s: float) -> None:
    lived = live(*silent(7.0, "force_torque"), release_s=release_s, until_s=9.3)
    assert lived.collision is None
    assert lived.contact == "released"
    assert lived.force_n < BEARABLE_N
    assert lived.state is State.FAULT


@pytest.mark.parametrize(
    ("faults", "orders"),
    [
        pytest.param(silent(5.80, "force_torque"), (), id="force lost as the tool touches"),
        pytest.param(silent(7.0, "distance", "camera"), (), id="position lost"),
        pytest.param(silent(7.0, *SENSORS), (), id="every sensor lost"),
        pytest.param((), ((7.0, "retreat"),), id="ordered to retreat"),
        pytest.param((), ((5.82, "stop"),), id="stopped at the first touch"),
        pytest.param((), ((5.87, "retreat"),), id="ordered to retreat as the touch is felt"),
        pytest.param((), ((5.91, "retreat"),), id="ordered to retreat before it presses"),
        pytest.param(
            (Fault(7.0, "force_torque", "offset", 0.05, 600.0, 3),), (), id="force beyond the limit"
        ),
    ],
)
def test_no_reason_for_a_retreat_pulls_at_the_clamp(
    faults: tuple[Fault, ...], orders: tuple[tuple[float, str], ...]
) -> None:
    lived = live(*faults, orders=orders)
    assert lived.collision is None
    assert lived.contact == "released"
    assert lived.force_n < BEARABLE_N


@pytest.mark.parametrize(
    ("release_s", "is_reported"),
    [pytest.param(0.3, False, id="signal missing"), pytest.param(NEVER_S, True, id="clamp stuck")],
)
def test_a_clamp_that_is_not_reported_open_is_followed_and_named(
    release_s: float, is_reported: bool
) -> None:
    # The conveyor starts again at 9 s: a tool that stood would be torn off.
    lived = live(
        orders=((7.0, "retreat"),), release_s=release_s, is_reported=is_reported, until_s=14.0
    )
    assert lived.collision is None
    assert lived.force_n < BEARABLE_N
    assert (lived.state, lived.because) == (State.RETREAT, CLAMP_CLOSED)
