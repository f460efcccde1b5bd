import math

import pytest

from linemate.simulators.devices.egm.guidance import Guidance, GuidanceConfig

CYCLE_S = 0.004
SPEED = 0.1  # [rad/s]


def lag_of_a_ramp(config: GuidanceConfig, *, feed_forward: bool) -> float:
    """Return by how much [s] a ramp is followed late once the filters have settled."""
    guidance = Guidance(config, CYCLE_S, (0.0,))
    speeds = (SPEED if feed_forward else 0.0,)
    setpoint = 0.0
    for k in range(1, 1000):
        setpoint = SPEED * k * CYCLE_S
        guidance.advance((setpoint,), speeds)
    return (setpoint - guidance.position[0]) / SPEED


@pytest.mark.parametrize(("hz", "gain"), [(20.0, 20.0), (40.0, 30.0), (10.0, 20.0)])
def test_a_ramp_is_followed_late_by_filter_and_gain(hz: float, gain: float) -> None:
    lag = lag_of_a_ramp(GuidanceConfig(hz, gain), feed_forward=False)
    # Half a cycle more or less: the filters are sampled.
    assert lag == pytest.approx(1.0 / (2.0 * math.pi * hz) + 1.0 / gain, abs=CYCLE_S)


def test_the_default_tuning_lags_by_forty_to_eighty_milliseconds() -> None:
    assert 0.040 < lag_of_a_ramp(GuidanceConfig(), feed_forward=False) < 0.080


def test_the_speed_reference_takes_the_position_loops_lag_away() -> None:
    lag = lag_of_a_ramp(GuidanceConfig(), feed_forward=True)
    assert lag == pytest.approx(1.0 / (2.0 * math.pi * 20.0), abs=CYCLE_S)


def test_without_position_gain_only_the_speed_reference_moves_the_robot() -> None:
    guidance = Guidance(GuidanceConfig(0.0, pos_corr_gain=0.0), CYCLE_S, (0.5,))
    for _ in range(100):
        guidance.advance((1.0,), (0.25,))
    assert guidance.position[0] == pytest.approx(0.5 + 100 * CYCLE_S * 0.25)


def test_the_speed_deviation_limits_a_jump() -> None:
    guidance = Guidance(GuidanceConfig(max_speed_deviation=0.2), CYCLE_S, (0.0,))
    before = 0.0
    for _ in range(50):
        position = guidance.advance((1.0,), (0.0,))[0]
        assert 0.0 < position - before <= 0.2 * CYCLE_S + 1e-12
        before = position
    assert guidance.is_clamped


def test_a_hold_forgets_what_was_still_to_be_made_up() -> None:
    guidance = Guidance(GuidanceConfig(), CYCLE_S, (0.0,))
    for _ in range(5):
        guidance.advance((1.0,), (0.0,))
    held = guidance.hold()
    assert guidance.advance(held, (0.0,)) == held


@pytest.mark.parametrize(
    "values",
    [
        {"lp_filter_hz": -1.0},
        {"position_gain": 0.0},
        {"pos_corr_gain": 1.5},
        {"max_speed_deviation": math.nan},
    ],
)
def test_a_tuning_that_no_controller_takes_is_refused(values: dict[str, float]) -> None:
    with pytest.raises(ValueError, match="EGM tuning out of range"):
        GuidanceConfig(**values)
