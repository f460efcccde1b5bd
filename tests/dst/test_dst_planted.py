"""A short share of the planted errors: each is found, and what is planted is taken out again.

``python -m linemate.simulators.lab.faults.dst_planted`` runs all of them up to 500 runs each.
"""

import pytest

from linemate.simulators.lab.faults import dst_planted, dst_run
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.plants.scenario import Fault

HELD_S = 1.45
PLANS: dict[str, FaultPlan] = {
    "camera-30-mm-off": FaultPlan(4),
    "coasting-3-s": FaultPlan(4, faults=(Fault(HELD_S, "force_torque", "silence", 0.5),)),
    "wrench-never-stale": FaultPlan(4, faults=(Fault(HELD_S, "force_torque", "silence", 0.5),)),
    "position-never-stale": FaultPlan(
        4, faults=(Fault(0.5, "camera", "silence", 0.6), Fault(0.5, "distance", "silence", 0.6))
    ),
    "overload-never": FaultPlan(4, faults=(Fault(0.5, "force_torque", "offset", 0.5, 600.0, 1),)),
    "clamp-never-opens": FaultPlan(
        4, duration_s=3.0, faults=(Fault(HELD_S, "force_torque", "silence", 0.4),)
    ),
    "wrench-crc-unchecked": FaultPlan(4, faults=(Fault(0.6, "force_torque", "flip", 0.6, 1.0, 2),)),
    "following-error-never": FaultPlan(4, faults=(Fault(-0.05, "robot", "drives_off", 0.9),)),
    "screws-anywhere": FaultPlan(4, duration_s=1.8),
}


def kinds(plan: FaultPlan) -> set[str]:
    return {what.partition(":")[0] for what in dst_run.run(plan).violations}


@pytest.mark.row
@pytest.mark.parametrize("name", PLANS)
def test_a_planted_error_is_a_violation_that_the_plan_has_not_without_it(name: str) -> None:
    with dst_planted.planted(name):
        found = kinds(PLANS[name])
    assert "exception" not in found
    assert found - kinds(PLANS[name])


def test_a_planted_error_is_found_within_a_few_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert dst_planted.main(["camera-30-mm-off", "--runs", "8"]) == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith("camera-30-mm-off: ")
    assert last == "0 not found within 8 runs"


def test_an_error_that_is_not_found_ends_with_1_and_an_unknown_one_with_2(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert dst_planted.main(["following-error-never", "--runs", "1", "--first", "4"]) == 1
    assert capsys.readouterr().out.splitlines()[-1] == "1 not found within 1 runs"
    assert dst_planted.main(["no-such-error"]) == 2


@pytest.mark.parametrize("name", dst_planted.ERRORS)
def test_what_is_planted_is_there_and_is_taken_out_again(name: str) -> None:
    patches = dst_planted.ERRORS[name]()
    assert patches
    before = [vars(owner)[what] for owner, what, _ in patches]
    with dst_planted.planted(name):
        assert all(
            vars(owner)[what] is not right
            for (owner, what, _), right in zip(patches, before, strict=True)
        )
    assert [vars(owner)[what] for owner, what, _ in patches] == before


def test_there_are_twenty_errors() -> None:
    assert len(dst_planted.ERRORS) == 20
