"""Compliance: a slow offset by force, bounded energy, and softening while it grows."""

import math
from collections.abc import Callable

import pytest

from linemate.daemon.core.tracking.touch import compliance
from linemate.daemon.core.tracking.touch.compliance import (
    ENERGY_J,
    NO_COMPLIANCE,
    REACH,
    SEATED_S,
    Compliance,
    ComplianceModel,
)
from linemate.daemon.core.tracking.touch.firmness import Firmness

GIVES_WAY = Compliance(firmness=Firmness(is_firm=False))
FIRM = Compliance(firmness=Firmness(is_firm=True))
MODEL = ComplianceModel(stiffness=50e3, delays=(12, 10, 12), dt=0.012)
SEATED = 2.0 * SEATED_S
OVERLOAD_N = 350.0


def followed(
    seconds: float,
    force: float,
    off: float,
    touching: float = SEATED,
    frequency_hz: float = 0.0,
    state: Compliance = GIVES_WAY,
    *,
    is_at_rest: bool = True,
) -> Compliance:
    """The state after a force, and an object off its estimate, along y."""
    for k in range(round(seconds / MODEL.dt)):
        ripple = math.cos(math.tau * frequency_hz * k * MODEL.dt)
        state = compliance.advance(
            state,
            MODEL,
            (0.0, force * ripple, 0.0),
            (0.0, off * ripple, 0.0),
            touching,
            is_at_rest=is_at_rest,
        )
    return state


def test_the_offset_takes_up_a_lasting_deviation_but_for_the_dead_band() -> None:
    state = followed(20.0, 0.0, 0.001)
    assert state.offset[1] == pytest.approx(0.001, abs=2.0 * compliance.DEAD_BAND)
    assert state.offset[0] == state.offset[2] == 0.0


def test_the_offset_follows_no_faster_than_its_rate() -> None:
    state = followed(0.1, 0.0, 0.001)
    assert 0.0 < state.offset[1] < 0.001 * compliance.RATE * 0.1


def test_a_tool_that_has_just_touched_is_aligned_at_once() -> None:
    assert followed(0.3, 0.0, 0.001, touching=0.05).offset[1] > 0.0007


def test_the_offset_is_bounded() -> None:
    assert math.hypot(*followed(60.0, 0.0, 1.0).offset) <= REACH * (1.0 + 1e-9)


@pytest.mark.parametrize("frequency_hz", [0.7, 1.5, 3.0, 5.0, 8.0])
def test_an_oscillation_gets_no_more_energy_than_the_bound_and_the_leak(
    frequency_hz: float,
) -> None:
    """Whatever the phase: the force leads or lags behind the offset's motion."""
    force, off = 40.0, 0.0008
    for lead in (0.0, 0.25, 0.5, 0.75):
        state, given, seconds = NO_COMPLIANCE, 0.0, 20.0
        offsets = []
        for k in range(round(seconds / MODEL.dt)):
            phase = math.tau * frequency_hz * k * MODEL.dt
            f = force * math.cos(phase + math.tau * lead)
            state = compliance.advance(
                state, MODEL, (0.0, f, 0.0), (0.0, off * math.cos(phase), 0.0), SEATED
            )
            offsets.append(state.offset[1])
            late = MODEL.delays[1] + 1
            if len(offsets) > late:
                given -= f * (offsets[-late] - offsets[-late - 1])
        assert given < 3.0 * ENERGY_J + compliance.LEAK_W * seconds


def test_a_growing_oscillation_softens_until_it_is_small() -> None:
    state, softened = NO_COMPLIANCE, []
    for k in range(700):
        t = k * MODEL.dt
        f = (10.0 + 30.0 * min(t, 3.0)) * math.sin(math.tau * 4.0 * t) * (t < 4.0)
        state = compliance.advance(state, MODEL, (0.0, f, 0.0), (0.0, 0.0, 0.0), SEATED)
        softened.append(state.soft)
    assert not softened[0]
    assert any(softened)
    assert not softened[-1]


def test_a_steady_oscillation_of_moderate_size_does_not_soften() -> None:
    assert not followed(5.0, 40.0, 0.0, frequency_hz=3.0).soft


def grown(frequency_hz: float, a_second: float, seconds: float = 6.0) -> Compliance:
    """The state after an oscillation that grows by a factor a second to 20 N."""
    state = GIVES_WAY
    for k in range(round(seconds / MODEL.dt)):
        t = k * MODEL.dt
        force = 20.0 * a_second ** (t - seconds) * math.sin(math.tau * frequency_hz * t)
        state = compliance.advance(state, MODEL, (0.0, force, 0.0), (0.0, 0.0, 0.0), SEATED)
    return state


def test_a_quick_oscillation_that_grows_for_seconds_is_driven_until_the_contact_ends() -> None:
    state = grown(3.5, 1.25)
    assert state.driven
    assert state.is_softened
    assert followed(10.0, 0.0, 0.0, state=state).driven


def test_a_driven_oscillation_that_grows_on_is_followed_again() -> None:
    assert not followed(2.0, 120.0, 0.0, frequency_hz=3.5, state=grown(3.5, 1.25)).driven


@pytest.mark.parametrize(("frequency_hz", "a_second"), [(3.5, 1.0), (3.5, 0.8), (1.0, 1.25)])
def test_one_that_does_not_grow_or_is_slow_is_not_driven(
    frequency_hz: float, a_second: float
) -> None:
    assert not grown(frequency_hz, a_second).driven


@pytest.mark.parametrize("frequency_hz", [1.0, 3.5])
def test_a_kick_is_not_driven(frequency_hz: float) -> None:
    state = followed(2.5, 5.0, 0.0, frequency_hz=frequency_hz)
    for seconds in (0.3, 0.7, 2.0):
        kicked = followed(seconds, 45.0, 0.0, frequency_hz=frequency_hz, state=state)
        assert not kicked.driven


def test_a_driven_contact_follows_a_lasting_deviation_and_hardly_a_swing() -> None:
    driven = Compliance(driven=True, press=(0.0, 0.0, 0.0), firmness=Firmness(is_firm=False))
    assert followed(20.0, 0.0, 0.001, state=driven).offset[1] == pytest.approx(0.001, abs=1e-4)
    swung = followed(5.0, 0.0, 0.001, frequency_hz=3.0, state=driven)
    assert abs(swung.offset[1]) < 1e-5


def test_a_softened_contact_moves_no_offset() -> None:
    before = Compliance(offset=(0.0, 0.001, 0.0), press=(0.0, 0.0, 0.0), power=3600.0, soft=True)
    after = compliance.advance(before, MODEL, (0.0, 0.0, 0.0), (0.0, 0.003, 0.0), SEATED)
    assert after.offset == before.offset


def test_a_lasting_softened_contact_follows_a_bent_mount_slowly_and_hardly_a_swing() -> None:
    """A mean deflection of 1.4 mm delayed the release by 10 s: the swing fell from 50 to 12 N."""
    soft = Compliance(press=(0.0, 0.0, 0.0), power=3600.0, soft=True, firmness=GIVES_WAY.firmness)
    bent, swung = soft, soft
    for k in range(round(10.0 / MODEL.dt)):
        swing = math.sin(math.tau * 1.0 * k * MODEL.dt)
        force = (0.0, 25.0 * swing, 0.0)
        bent = compliance.advance(bent, MODEL, force, (0.0, 0.0014, 0.0), SEATED)
        swung = compliance.advance(swung, MODEL, force, (0.0, 0.001 * swing, 0.0), SEATED)
        assert bent.soft
        assert swung.soft
    assert bent.offset[1] > 0.9 * 0.0014
    assert abs(swung.offset[1]) < 3e-5


def test_an_oscillation_makes_a_deflection_uncertain_after_a_while() -> None:
    assert compliance.uncertainty(followed(0.1, 40.0, 0.0, frequency_hz=4.0), MODEL) == 0.0
    late = compliance.uncertainty(followed(3.0, 40.0, 0.0, frequency_hz=4.0), MODEL)
    assert math.sqrt(late) == pytest.approx(40.0 / math.sqrt(2.0) / 50e3, rel=0.2)


def test_a_class_that_takes_over_clears_the_offset_along_the_conveyor() -> None:
    state = Compliance(offset=(0.001, 0.002, 0.003))
    assert compliance.taken_over(state, 1).offset == (0.001, 0.0, 0.003)


def test_an_object_that_lies_still_is_proved_firm_and_moves_no_offset() -> None:
    assert followed(0.9, 0.0, 0.0, state=NO_COMPLIANCE).firmness.is_firm is None
    proved = followed(1.2, 0.0, 0.0, state=NO_COMPLIANCE)
    assert proved.is_firm
    assert followed(1.0, 0.0, 0.001, state=proved).offset == proved.offset


def test_next_to_a_running_line_nothing_is_proved_and_a_proof_ends() -> None:
    still = followed(5.0, 0.0, 0.0, state=NO_COMPLIANCE, is_at_rest=False)
    assert still.firmness.is_firm is None
    later = followed(MODEL.dt, 0.0, 0.0, state=FIRM, is_at_rest=False)
    assert later.firmness.is_firm is None
    assert not followed(0.9, 0.0, 0.0, state=later).is_firm


def test_nothing_is_proved_before_the_tool_has_seated() -> None:
    assert followed(3.0, 0.0, 0.0, touching=0.5, state=NO_COMPLIANCE).firmness.is_firm is None


def test_a_push_shows_that_an_object_is_not_firm() -> None:
    force = (0.0, 0.0, 0.0)
    after = compliance.advance(FIRM, MODEL, force, force, SEATED, is_pushed=True)
    assert after.firmness.is_firm is False


def test_an_oscillation_shows_that_an_object_is_not_firm() -> None:
    assert followed(1.0, 30.0, 0.0, frequency_hz=4.0, state=FIRM).firmness.is_firm is False


def swung(amplitudes: list[float], frequency_hz: float = 0.9) -> Compliance:
    """The state after a force that swings along y, a second with each amplitude."""
    state, model = GIVES_WAY, MODEL
    for k in range(round(len(amplitudes) / model.dt)):
        seconds = k * model.dt
        force = amplitudes[int(seconds)] * math.sin(math.tau * frequency_hz * seconds)
        state = compliance.advance(state, model, (0.0, force, 0.0), (0.0, 0.0, 0.0), SEATED)
    return state


@pytest.mark.parametrize("frequency_hz", [0.9, 2.0, 4.7])
def test_a_large_oscillation_that_softening_does_not_end_is_unending(frequency_hz: float) -> None:
    rms = compliance.unending(swung([200.0, 200.0, 210.0, 210.0], frequency_hz), OVERLOAD_N)
    assert rms is not None
    assert 87.5 < rms < 210.0


@pytest.mark.parametrize(
    "amplitudes",
    [[100.0] * 4, [250.0, 200.0, 150.0, 100.0], [200.0, 200.0], [90.0, 90.0, 90.0, 200.0]],
    ids=["small", "falls", "has not lasted", "is kicked again"],
)
def test_an_oscillation_that_is_small_or_falls_or_is_young_is_not_unending(
    amplitudes: list[float],
) -> None:
    assert compliance.unending(swung(amplitudes), OVERLOAD_N) is None


def test_an_oscillation_is_worth_a_dropped_wheel_from_half_of_the_overload_only() -> None:
    state = swung([200.0, 200.0, 210.0, 210.0], 2.0)
    assert compliance.unending(state, OVERLOAD_N, compliance.UNSECURED) is None
    larger = swung([300.0, 300.0, 310.0, 310.0], 2.0)
    assert compliance.unending(larger, OVERLOAD_N, compliance.UNSECURED) is not None


def test_a_large_oscillation_that_has_become_small_is_not_unending() -> None:
    large = swung([200.0, 200.0, 200.0], 2.0)
    assert compliance.unending(large, OVERLOAD_N) is not None
    small = followed(0.5, 100.0, 0.0, frequency_hz=2.0, state=large)
    # Its largest mean square of the last second is still that of the second before.
    assert max(small.past[-compliance.SECOND :]) > 0.95 * max(large.past)
    assert compliance.unending(small, OVERLOAD_N) is None


def test_a_force_in_every_second_cycle_counts_as_one_in_every_cycle_of_twice_the_length() -> None:
    coarse = ComplianceModel(stiffness=50e3, delays=(12, 10, 12), dt=0.004)
    fine = ComplianceModel(stiffness=50e3, delays=(24, 20, 24), dt=0.002)
    ends = []
    for model, every in ((coarse, 1), (fine, 2)):
        state = NO_COMPLIANCE
        for k in range(every * 500):
            if k % every != every - 1:
                state = compliance.waiting(state)
                continue
            t = (k + 1) * model.dt
            force = 20.0 * math.sin(math.tau * 1.5 * t)
            off = -5e-3 * math.sin(math.tau * 1.5 * (t + 0.04))
            state = compliance.advance(
                state, model, (0.0, force, 0.0), (0.0, off, 0.0), SEATED, is_at_rest=True
            )
        ends.append(state)
    slow, quick = ends
    assert quick.offset == pytest.approx(slow.offset, rel=1e-9)
    assert quick.power == pytest.approx(slow.power, rel=1e-9)
    assert quick.energy == pytest.approx(slow.energy, rel=1e-6)
    assert quick.energy > 0.0
    assert quick.past == pytest.approx(slow.past)
    assert quick.firmness == slow.firmness


def test_a_force_sensor_that_was_silent_proves_nothing_for_that_time() -> None:
    calm = followed(0.5, 0.0, 0.0, state=NO_COMPLIANCE)
    silent = calm
    for _ in range(200):
        silent = compliance.waiting(silent)
    after = followed(MODEL.dt, 0.0, 0.0, state=silent)
    assert after.firmness.calm_s == pytest.approx(calm.firmness.calm_s + MODEL.dt)
    assert not after.is_firm


def bent(peaks: list[float], length_s: float = 0.4) -> Compliance:
    """The state at the last peak of a force that bends the mount along y, half a sine for each."""
    state = NO_COMPLIANCE
    for k in range(round((len(peaks) - 0.5) * length_s / MODEL.dt)):
        late = k * MODEL.dt / length_s
        force = peaks[int(late)] * math.sin(math.pi * (late % 1.0))
        state = compliance.advance(
            state, MODEL, (0.0, force, 0.0), (0.0, -force / MODEL.stiffness, 0.0), SEATED
        )
    return state


def test_a_stop_that_bends_the_mount_to_one_side_and_back_is_no_oscillation() -> None:
    state = bent([-170.0, 200.0])
    assert math.sqrt(state.power) > 1.2 * compliance.LARGEST_N
    assert not state.is_softened
    assert compliance.uncertainty(state, MODEL) == 0.0


def test_a_force_that_swings_on_to_and_fro_softens_and_makes_a_deflection_uncertain() -> None:
    state = bent([-170.0, 200.0, -200.0, 200.0])
    assert state.is_softened
    assert compliance.uncertainty(state, MODEL) > 0.001**2


def seated(force_of: Callable[[float], float], seconds: float) -> Compliance:
    """The state of a tool that seats with a force along y."""
    state = NO_COMPLIANCE
    for k in range(round(seconds / MODEL.dt)):
        t = k * MODEL.dt
        force = (0.0, force_of(t), 0.0)
        state = compliance.advance(state, MODEL, force, (0.0, 0.0, 0.0), t)
    return state


def test_a_ring_of_a_tool_that_seats_makes_its_deflection_no_evidence_of_a_class() -> None:
    state = seated(lambda t: 40.0 * math.sin(math.tau * 4.0 * t), 0.33)
    assert math.sqrt(compliance.ringing(state, MODEL)) > 15.0 / MODEL.stiffness
    # The target follows a deflection as before.
    assert compliance.uncertainty(state, MODEL) == 0.0


def test_a_force_to_one_side_of_a_tool_that_seats_is_evidence_of_a_stop() -> None:
    state = seated(lambda t: -100.0 * t * t / 0.1, 0.33)
    assert compliance.ringing(state, MODEL) == 0.0


def test_a_ring_ends_when_the_tool_has_seated() -> None:
    state = seated(lambda t: 40.0 * math.sin(math.tau * 4.0 * t), SEATED_S + 0.05)
    assert compliance.ringing(state, MODEL) == 0.0
