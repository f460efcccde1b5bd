"""A line that stops and starts several times as fast as its task file states, in contact."""

import json

import pytest

from linemate.simulators.harness import lockstep, setup
from linemate.simulators.judge.judge import judge

STATED_START = 0.013  # [m/s^2]


def events(*orders: tuple[float, float]) -> str:
    """The conveyor's orders: times [s], and accelerations [m/s^2], less than 0 for a stop."""
    named = [
        {"kind": "start" if a > 0.0 else "stop", "onset_s": t, "acceleration": abs(a)}
        for t, a in orders
    ]
    return f"scenario.conveyor.events={json.dumps(named)}"


@pytest.mark.row
@pytest.mark.parametrize(
    ("seed", "orders"),
    [
        # While the classifier held on to the stated acceleration: torn, 312 N, torn.
        (2002, ((11.638, -0.163), (15.622, 0.078), (16.252, -0.183))),
        (2014, ((10.022, -0.167), (12.17, 0.082))),
        (1003, ((11.096, -0.104), (11.636, 0.4))),
        # While a body that sways hid a stop right after a start: torn, torn.
        (2010, ((10.614, -0.18), (13.179, 0.085), (14.549, -0.294))),
        (3003, ((10.107, -0.148), (12.387, 0.087), (13.7, -0.289), (14.347, 0.048))),
    ],
)
def test_a_start_faster_than_stated_tears_no_mount(
    seed: int, orders: tuple[tuple[float, float], ...]
) -> None:
    assert max(a for _, a in orders) > 4.0 * STATED_START
    changes = [events(*orders), "scenario.duration_s=17.5"]
    evidence = lockstep.run(setup.make("plant-floor", changes), seed)
    assert evidence.collision is None
    assert judge(evidence)["contact_force_n"]["max"] < 250.0
