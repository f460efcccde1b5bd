"""What the classes' motions are: the way gone, ending where the class ends."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from linemate.daemon.core.tracking.conveyor import way

NOMINAL = 0.106
speeds = st.floats(-0.02, 0.15)
accelerations = st.sampled_from((-0.104, -0.08, 0.0, 0.013, 0.016))
times = st.floats(0.0, 12.0)


def speed_at(t: float, speed: float, acceleration: float) -> float:
    """The class's speed, by its ends."""
    if acceleration < 0.0:
        return max(speed + acceleration * t, min(speed, 0.0))
    if acceleration > 0.0:
        return min(speed + acceleration * t, max(speed, NOMINAL))
    return speed


@settings(max_examples=80, deadline=None)
@given(speeds, accelerations, times)
def test_travel_is_the_integral_of_a_speed_that_ends_at_rest_or_at_nominal(
    speed: float, acceleration: float, t: float
) -> None:
    end = abs((NOMINAL if acceleration > 0.0 else 0.0) - speed) / max(abs(acceleration), 1e-9)
    known, _ = quad(
        speed_at, 0.0, t, args=(speed, acceleration), points=sorted({min(end, t), 0.0, t})
    )
    gone = way(speed, acceleration, NOMINAL, np.array((t,)))
    assert gone.shape == (1,)
    assert float(gone[0]) == pytest.approx(known, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 0.15), st.floats(0.01, 0.2))
def test_a_stop_never_runs_backwards_and_ends_after_v2_over_2a(speed: float, brake: float) -> None:
    t = np.linspace(0.0, 20.0, 300)
    gone = way(speed, -brake, NOMINAL, t)
    assert (np.diff(gone) >= -1e-12).all()
    assert float(gone[-1]) == pytest.approx(speed**2 / (2.0 * brake), abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(st.floats(0.0, 0.1), st.floats(0.005, 0.1))
def test_a_start_goes_on_at_nominal_speed(speed: float, push: float) -> None:
    late = way(speed, push, NOMINAL, np.array((100.0, 101.0)))
    assert float(np.diff(late)[0]) == pytest.approx(NOMINAL, abs=1e-9)
