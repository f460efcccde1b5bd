"""Timed faults: what is in force and what strikes."""

import pytest

from linemate.simulators.devices.faults import KINDS, MEANINGS, REAL, Faults
from linemate.simulators.plants.scenario import Fault


def test_a_fault_is_in_force_for_its_duration_on_its_link() -> None:
    faults = Faults([Fault(1.0, "camera", "silence", duration_s=0.5)])
    assert faults.in_force("camera", "silence", 0.99) is None
    assert faults.in_force("camera", "silence", 1.0) is not None
    assert faults.in_force("camera", "silence", 1.5) is None
    assert faults.in_force("distance", "silence", 1.2) is None
    assert faults.in_force("camera", "delay", 1.2) is None


def test_each_strike_comes_once_and_in_order() -> None:
    faults = Faults(
        [
            Fault(2.0, "distance", "unplug", duration_s=1.0),
            Fault(1.0, "robot", "garbage", count=3),
            Fault(1.5, "robot", "silence", duration_s=1.0),
        ]
    )
    assert list(faults.strike(0.5)) == []
    assert [fault.kind for fault in faults.strike(1.2)] == ["garbage"]
    assert [fault.kind for fault in faults.strike(9.0)] == ["unplug"]
    assert list(faults.strike(9.0)) == []


@pytest.mark.parametrize(("link", "kind"), [("radio", "silence"), ("camera", "unplug")])
def test_a_fault_that_there_is_not_is_refused_at_once(link: str, kind: str) -> None:
    with pytest.raises(ValueError, match=r"fault at 1\.0 s"):
        Faults([Fault(1.0, link, kind)])


def test_every_kind_that_a_link_can_suffer_is_explained_and_no_other() -> None:
    assert {kind for kinds in KINDS.values() for kind in kinds} == set(MEANINGS)
    assert all(set(kinds) <= set(KINDS[link]) for link, kinds in REAL.items())


def test_what_only_virtual_time_can_do_is_refused_on_real_links() -> None:
    fault = Fault(1.0, "robot", "ipoc_flip", duration_s=1.0)
    Faults([fault])
    with pytest.raises(ValueError, match="robot has no 'ipoc_flip'"):
        Faults([fault], REAL)
