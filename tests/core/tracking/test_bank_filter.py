"""The bank's filter: readings that freeze, jump, slip or come late, contact, and ends of ramps."""

import math
from collections.abc import Callable

import numpy as np
import pytest
from conveyor_bank import BANK, CAMERA_DELAY, NEVER
from conveyor_truth import DEVIATION, NOMINAL, T0, Truth
from msgspec import structs

from linemate.daemon.core.tracking.classifiers import bank_filter, bank_prediction
from linemate.daemon.core.tracking.classifiers.bank_filter import FROZEN_S, MOST_REJECTED
from linemate.daemon.core.tracking.classifiers.bank_model import (
    ACCELERATION,
    OFFSET,
    SLIP,
    STATES,
    BankState,
    V,
    Y,
)
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.conveyor import Motion, PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.core.tracking.task import ConveyorClasses


def widened_after(
    reading: Callable[[float], float], seconds: float = 0.6, *, touch: bool = False
) -> float | None:
    """Time after 2 s until a filter whose readings then change is widened [s]; None if never.

    Args:
        touch: the object is felt from 1 s on.
    """
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng = np.random.default_rng(2)
    state, begun = bank.initial(0.0), 2.0
    for k in range(round((begun + seconds) / T0)):
        t = k * T0
        value = NOMINAL * t + rng.normal(0.0, 2e-4) if t < begun else reading(t - begun)
        rows = [PositionMeasurement(Source.DISTANCE, value, 0.001, DEVIATION**2, 4.0)]
        if touch and t > 1.0:
            felt = NOMINAL * t + rng.normal(0.0, 1e-5)
            rows.append(PositionMeasurement(Source.TACTILE, felt, 0.001, 25e-10, 20.0))
        later = bank.advance(state, rows, T0)
        if takes_again(state, later):
            return t - begun
        state = later
    return None


def takes_again(before: BankState, state: BankState) -> bool:
    """Whether the filter was widened in this step, for readings that it rejected."""
    return before.rejected.get(Source.DISTANCE, 0) > 1 and not state.rejected


@pytest.mark.parametrize("touch", [False, True])
def test_a_frozen_sensor_widens_no_filter_before_its_health_excludes_it(touch: bool) -> None:
    """The widened filter braked a tool that was about to touch: 239 N at the clamp.

    In contact it detected no stop for 0.6 s: 202 N.
    """
    lasting = widened_after(lambda _: NOMINAL * 2.0, touch=touch)
    assert lasting is not None
    assert 0.2 < lasting < 0.4


@pytest.mark.parametrize(
    ("contact", "firm", "deviation"),
    [(True, False, 0.002), (True, False, 0.02), (True, True, 0.002), (False, False, 0.002)],
)
def test_a_widened_filter_tests_for_changes_as_the_force_shows_the_speed(
    contact: bool, firm: bool, deviation: float
) -> None:
    """It missed a start within a stop for 0.6 s: 392 N."""
    P = np.zeros((STATES, STATES))
    P[V, V] = deviation**2
    widened = structs.replace(BANK.initial(0.0), P=P, contact=contact, is_firm=firm)
    later = bank_filter.predict(BANK, widened, T0)
    is_known = contact and not firm and deviation < bank_filter.KNOWN
    assert bool(len(later.changes)) is is_known


def test_readings_that_have_jumped_and_go_on_widen_the_filter_at_once() -> None:
    lasting = widened_after(lambda later: NOMINAL * (2.0 + later) - 0.02)
    assert lasting is not None
    assert lasting < 0.15


def test_readings_that_run_backwards_widen_no_filter() -> None:
    """Of a sensor whose sign is wrong: the widened filter led the tool back along the line."""
    assert widened_after(lambda later: NOMINAL * (2.0 - later) - 0.02) is None


@pytest.mark.parametrize(("share", "least", "most"), [(1.0, 0.0, 0.01), (0.5, 0.03, 0.06)])
def test_readings_that_have_jumped_and_go_on_at_their_speed_leave_it_known(
    share: float, least: float, most: float
) -> None:
    """A sensor late by 33 ms made the speed unknown: the tool was led 11 mm off the hub."""
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng, state = np.random.default_rng(4), bank.initial(0.0)
    for t in np.arange(0.0, 2.6, T0):
        value = NOMINAL * t if t < 2.0 else NOMINAL * (2.0 + share * (t - 2.0)) - 0.0035
        value += rng.normal(0.0, 2e-4)
        row = PositionMeasurement(Source.DISTANCE, value, 0.0, DEVIATION**2, 4.0)
        before, state = state, bank.advance(state, [row], T0)
        if takes_again(before, state):
            break
    else:
        pytest.fail("it was never widened")
    assert least <= math.sqrt(float(state.P[V, V])) < most


@pytest.mark.parametrize("size", [-0.03, 0.03])
@pytest.mark.parametrize("seed", range(3))
def test_a_step_of_a_coarse_distance_sensor_leaves_the_object_where_it_was(
    size: float, seed: int
) -> None:
    """Half of it was taken for a way of the object, and no stop was looked for: 12 mm off."""
    deviation, cycle_s = 0.004, 0.01
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), deviation)
    rng, state, widened = np.random.default_rng(seed), bank.initial(0.0), False
    for k in range(1, 250):
        t = k * cycle_s
        read = NOMINAL * t + rng.normal(0.0, 2e-3) + (size if t > 2.0 else 0.0)
        read = round(1e2 * read) / 1e2
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.0, deviation**2, 5.0)]
        if t < 1.8 and k % 4 == 0:  # then the camera is blind
            seen = NOMINAL * t + rng.normal(0.0, 5e-4)
            rows.append(PositionMeasurement(Source.CAMERA, seen, 0.0, 5e-4**2, 5.0))
        before, state = state, bank.advance(state, rows, cycle_s)
        widened = widened or takes_again(before, state)
    assert widened
    assert state.x[Y] == pytest.approx(NOMINAL * t, abs=2e-3)
    assert state.x[OFFSET] == pytest.approx(size, abs=4e-3)
    assert state.age == pytest.approx(t)


def test_a_distance_sensor_that_becomes_late_in_contact_leaves_the_filter_settled() -> None:
    """It was widened, and no stop was looked for in the 0.6 s after it: 212 N."""
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng, state, widened, late_s = np.random.default_rng(3), bank.initial(0.0), False, 0.02
    for k in range(1, round(2.6 / T0)):
        t, rows = k * T0, []
        if not 2.0 < t < 2.0 + late_s:
            read = NOMINAL * (t - (late_s if t > 2.0 else 0.0)) + rng.normal(0.0, 2e-4)
            rows.append(PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0))
        if t > 1.0:
            felt = NOMINAL * t + rng.normal(0.0, 1e-5)
            rows.append(PositionMeasurement(Source.TACTILE, felt, 0.001, 25e-10, 20.0))
        before, state = state, bank.advance(state, rows, T0)
        widened = widened or takes_again(before, state)
    assert widened
    assert state.age == pytest.approx(t)


def test_a_coarse_distance_sensor_that_repeats_itself_is_not_frozen() -> None:
    """Its step of 30 mm was rejected for so long that it was taken for a speed of 0.22 m/s."""
    deviation, cycle_s, stepped_s = 0.004, 0.01, 2.4056  # just when the reading changes
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), deviation)
    state, rejected = bank.initial(0.0), 0
    for k in range(1, 260):
        t = k * cycle_s
        read = round(1e2 * (NOMINAL * t + (0.03 if t > stepped_s else 0.0))) / 1e2
        row = PositionMeasurement(Source.DISTANCE, read, 0.0, deviation**2, 5.0)
        before, state = state, bank.advance(state, [row], cycle_s)
        rejected = max(rejected, state.rejected.get(Source.DISTANCE, 0))
        if takes_again(before, state):
            break
    assert rejected == MOST_REJECTED - 1
    assert t - stepped_s < FROZEN_S


@pytest.mark.parametrize("seed", range(4))
def test_a_frozen_distance_sensor_is_not_predicted_as_a_stop(seed: int) -> None:
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), DEVIATION)
    rng = np.random.default_rng(seed)
    state, frozen_s, ahead = bank.initial(0.0), 2.0, np.array([0.24])
    speeds = []
    for k in range(1, round((frozen_s + 0.15) / T0)):
        value = NOMINAL * min(k * T0, frozen_s) + rng.normal(0.0, DEVIATION)
        row = PositionMeasurement(Source.DISTANCE, value, 0.0, DEVIATION**2, 4.0)
        state = bank.advance(state, [row], T0)
        if state.rejected.get(Source.DISTANCE, 0) >= bank_prediction.CONTRADICTED:
            now, later = bank.predict_positions(state, np.append(0.0, ahead)).tolist()
            speeds.append((later - now) / float(ahead[0]))
    assert speeds
    assert min(speeds) > 0.95 * NOMINAL


@pytest.mark.parametrize("slip", [0.008, -0.008])
def test_a_wheel_that_slips_is_learnt_from_the_camera_while_the_conveyor_runs(slip: float) -> None:
    fusion = FusionSettings()
    bank = BankClassifier(ConveyorClasses(), fusion, BankSettings(), DEVIATION)
    truth, rng = Truth(6.0, seed=5), np.random.default_rng(6)
    times = np.arange(-1.0, 6.0, T0)
    state = bank.initial(float(truth.at(-1.0)))
    for k, t in enumerate(times):
        read = (1.0 + slip) * float(truth.at(t - 0.001)) + rng.normal(0.0, DEVIATION)
        rows = [PositionMeasurement(Source.DISTANCE, read, 0.001, DEVIATION**2, 4.0)]
        if k % 2:
            seen = float(truth.at(t - CAMERA_DELAY)) + rng.normal(0.0, 5e-4)
            rows.append(PositionMeasurement(Source.CAMERA, seen, CAMERA_DELAY, 25e-8, 5.0))
        state = bank.advance(state, rows, T0)
    assert state.x[SLIP] == pytest.approx(slip, abs=0.0015)
    assert abs(bank.estimate(state).position - float(truth.at(times[-1]))) < 0.5e-3
    # Taken for the conveyor's, the slip would be 0.85 mm/s of speed.
    assert state.x[1] == pytest.approx(NOMINAL, abs=0.5e-3)


def test_a_contact_lasts_from_one_deflection_to_the_next_and_ends_without() -> None:
    """The force-torque sensor has 250 Hz, and the controller 500: every second step is felt."""
    dt, state = 0.002, BANK.initial(0.0)
    touch = PositionMeasurement(
        Source.TACTILE, 0.0, 0.001, 1e-10, NEVER, is_firm=True, complied=0.0003
    )
    seen = []
    for k in range(40):
        state = BANK.advance(state, [touch] if 10 <= k < 30 and k % 2 == 0 else [], dt)
        seen.append((state.contact, state.is_keen, state.is_firm, state.complied))
    touched, free = (True, True, True, 0.0003), (False, False, False, 0.0)
    # The last deflection came in step 28; 8 ms later there is no contact any more.
    assert seen == [free] * 10 + [touched] * 22 + [free] * 8


def test_a_ring_of_the_tool_makes_its_deflection_less_evidence() -> None:
    state, moved = BANK.initial(0.0), []
    for ringing in (0.0, 0.001**2):
        row = PositionMeasurement(Source.TACTILE, 0.002, 0.001, 1e-10, NEVER, ringing=ringing)
        felt = BANK.advance(state, [row], T0)
        moved.append((felt.is_keen, float(felt.P[0, 0])))
    assert [is_keen for is_keen, _ in moved] == [True, False]
    assert moved[1][1] > 50.0 * moved[0][1]


@pytest.mark.parametrize("motion", [Motion.STOPPING, Motion.STARTING])
def test_the_acceleration_is_uncertain_at_the_end_of_a_ramp(motion: Motion) -> None:
    """Drives end their ramps smoothly: on an S it fades within a third of the ramp."""
    state, noise = structs.replace(BANK.initial(0.0), motion=motion), []
    end = 0.0 if motion is Motion.STOPPING else state.cruise
    for speed in (0.5 * state.cruise, end):
        x = state.x.copy()
        x[V] = speed
        noise.append(float(BANK.process_noise(structs.replace(state, x=x), T0)[ACCELERATION]))
    assert noise[1] > 20.0 * noise[0]


def test_a_stop_that_began_before_a_start_ends_is_tested_on() -> None:
    """Tested again from that end on, it was confirmed 0.4 s late: 290 N."""
    state = structs.replace(BANK.initial(0.0), motion=Motion.STARTING, age=5.0, tentative=True)
    x = state.x.copy()
    x[V], x[ACCELERATION] = state.cruise, 0.013
    onsets = BANK.change_onsets[Motion.STARTING]
    evidence = np.array([[50.0], [50.0], [0.1], [0.0], [0.0]])
    changes = structs.replace(onsets, sums=onsets.sums + evidence)
    ended = bank_filter.predict(BANK, structs.replace(state, x=x, changes=changes), T0)
    assert ended.motion is Motion.RUNNING
    assert ended.tentative
    oldest = ended.changes.sums[:, -1]
    assert oldest[:3] == pytest.approx((50.0, 50.0, 0.1 + T0))
    # Without the start it adds what a stop of a running conveyor does.
    error = float(ended.changes.error[ACCELERATION, -1])
    running = BANK.change_onsets[Motion.RUNNING]
    assert error == pytest.approx(float(running.error[ACCELERATION, 0]), rel=0.01)
