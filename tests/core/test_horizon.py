"""Values over the horizon's times are computed again where they have to be, and only there."""

import numpy as np

from linemate.daemon.core.horizon import Array, KeptValues

TIMES = np.arange(4.0)


def test_values_are_computed_again_for_another_key_or_other_times() -> None:
    asked: list[tuple[float, int]] = []

    def scaled(factor: float, times: Array) -> Array:
        asked.append((factor, len(times)))
        return factor * times

    kept = KeptValues(scaled)
    assert kept(2.0, TIMES).tolist() == [0.0, 2.0, 4.0, 6.0]
    assert kept(2.0, TIMES) is kept(2.0, TIMES)
    assert kept(3.0, TIMES).tolist() == [0.0, 3.0, 6.0, 9.0]
    assert kept(3.0, TIMES[:2]).tolist() == [0.0, 3.0]
    assert asked == [(2.0, 4), (3.0, 4), (3.0, 2)]
    assert not kept(3.0, TIMES).flags.writeable
