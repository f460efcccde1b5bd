"""The spline is the one that scipy would make."""

import numpy as np
import pytest
from scipy import interpolate

from linemate.daemon.core import cubic_spline


@pytest.mark.parametrize("count", [2, 3, 4, 96])
@pytest.mark.parametrize("begins_at_rest", [True, False])
def test_values_and_derivatives_are_those_of_scipy(count: int, begins_at_rest: bool) -> None:
    rng = np.random.default_rng(count)
    knots = np.cumsum(rng.uniform(0.002, 0.5, count))
    values = rng.normal(size=(count, 6))
    start = (1 if begins_at_rest else 2, np.zeros(6))
    scipys = interpolate.CubicSpline(knots, values, bc_type=(start, (2, np.zeros(6))))
    ours = cubic_spline.through(knots, values, begins_at_rest=begins_at_rest)
    at = np.concatenate((knots, rng.uniform(knots[0] - 0.1, knots[-1] + 0.1, 200)))
    for order in range(3):
        wanted = scipys(at, order)
        near = 1e-9 * (1.0 + abs(wanted).max())
        assert ours(at, order) == pytest.approx(wanted, rel=1e-9, abs=near)
        assert ours(float(at[0]), order) == pytest.approx(wanted[0], abs=near)
    assert ours.coefficients == pytest.approx(
        scipys.c, rel=1e-6, abs=1e-9 * (1.0 + abs(scipys.c).max())
    )


@pytest.mark.parametrize("knots", [(0.0,), (0.0, 0.0), (0.0, 2.0, 1.0)])
def test_knots_that_do_not_ascend_are_refused(knots: tuple[float, ...]) -> None:
    with pytest.raises(ValueError, match="ascending"):
        cubic_spline.through(np.array(knots), np.zeros((len(knots), 6)), begins_at_rest=True)
