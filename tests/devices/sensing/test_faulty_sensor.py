"""What a faulty sensor says instead of its reading, and what its clock shows."""

import math

import pytest

from linemate.simulators.devices.faults import Faults
from linemate.simulators.devices.sensing.faulty_sensor import ODD, FaultySensor
from linemate.simulators.plants.scenario import Fault

POSE = (0.1, 0.2, 0.3, 1.0, 0.0, 0.0, 0.0)


def sensor(kind: str, value: float = 0.0, count: int = 1) -> FaultySensor:
    faults = Faults([Fault(1.0, "camera", kind, duration_s=1.0, value=value, count=count)])
    return FaultySensor("camera", faults, seed=7)


def test_a_sound_sensor_says_what_it_reads() -> None:
    sound = sensor("stuck")
    assert sound.reading(POSE, 0.5) == POSE
    assert sound.reading(POSE, 2.0) == POSE
    assert sound.clock(1.5) == 1.5


def test_a_stuck_sensor_repeats_its_first_reading() -> None:
    stuck = sensor("stuck")
    assert stuck.reading((1.0, 2.0), 1.0) == (1.0, 2.0)
    assert stuck.reading((3.0, 4.0), 1.9) == (1.0, 2.0)
    assert stuck.reading((3.0, 4.0), 2.1) == (3.0, 4.0)


def test_a_wrong_unit_scales_lengths_and_leaves_a_quaternion_alone() -> None:
    scaled = sensor("scale", 1000.0).reading(POSE, 1.5, additive=3)
    assert scaled == pytest.approx((100.0, 200.0, 300.0, 1.0, 0.0, 0.0, 0.0))


@pytest.mark.parametrize(("count", "changed"), [(1, {0}), (3, {2}), (0, {0, 1, 2})])
def test_an_offset_shifts_the_component_that_it_names(count: int, changed: set[int]) -> None:
    shifted = sensor("offset", 0.02, count).reading(POSE, 1.5, additive=3)
    for i, (a, b) in enumerate(zip(shifted, POSE, strict=True)):
        assert a - b == pytest.approx(0.02 if i in changed else 0.0)


def test_a_drift_grows_with_time() -> None:
    drifting = sensor("drift", 0.1)
    assert drifting.reading((1.0,), 1.0) == (1.0,)
    assert drifting.reading((1.0,), 1.5) == pytest.approx((1.05,))


def test_nan_and_its_kin_come_one_component_at_a_time() -> None:
    odd = sensor("nan", 1.0)
    seen = [odd.reading(POSE, 1.0 + 0.001 * i) for i in range(900)]
    kinds = {
        repr(a)
        for reading in seen
        for a, b in zip(reading, POSE, strict=True)
        if repr(a) != repr(b)
    }
    assert kinds == {repr(value) for value in ODD}
    for reading in seen:
        assert sum(repr(a) != repr(b) for a, b in zip(reading, POSE, strict=True)) <= 1
    assert any(math.isnan(a) for reading in seen for a in reading)


@pytest.mark.parametrize(
    ("kind", "value", "shown"),
    [("clock_step", 3600.0, 3601.5), ("clock_rate", 0.1, 1.55), ("clock_frozen", 0.0, 1.0)],
)
def test_a_wrong_clock_shows_another_time(kind: str, value: float, shown: float) -> None:
    assert sensor(kind, value).clock(1.5) == pytest.approx(shown)
    assert sensor(kind, value).clock(2.5) == 2.5


TURNED_POSE = (1.0, 2.0, 3.0, 0.5, 0.5, 0.5, 0.5)


def test_a_pose_in_a_wrong_frame_is_turned_by_90_degrees_about_z() -> None:
    sensor = FaultySensor("camera", Faults([Fault(0.0, "camera", "frame", 1.0)]), 1)
    turned = sensor.reading(TURNED_POSE, 0.5, additive=3)
    assert turned[:3] == (-2.0, 1.0, 3.0)
    assert turned[3:] == pytest.approx((0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5)))
    assert sensor.reading(TURNED_POSE, 1.5, additive=3) == TURNED_POSE


def test_a_flipped_quaternion_is_the_inverse_rotation() -> None:
    sensor = FaultySensor("camera", Faults([Fault(0.0, "camera", "flipped", 1.0)]), 1)
    assert sensor.reading(TURNED_POSE, 0.5, additive=3) == (1.0, 2.0, 3.0, 0.5, -0.5, -0.5, -0.5)
