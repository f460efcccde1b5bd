"""The time after which a stop is seen, against the bank that sees it."""

import numpy as np
import pytest
from conveyor_truth import NOMINAL, STOP, T0

from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.classifiers.distance.stop_delay import seen_after
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.core.tracking.task import ConveyorClasses

STEADY_S = 3.0
RUNS = 25


def delay(deviation: float, seed: int) -> float:
    """Return the time from a stop's onset until the bank perceives it [s]."""
    rng = np.random.default_rng(seed)
    bank = BankClassifier(ConveyorClasses(), FusionSettings(), BankSettings(), deviation)
    state, t = bank.initial(0.0), 0.0
    while t < STEADY_S + 1.0:
        t += T0
        value = NOMINAL * t - 0.5 * STOP * max(t - STEADY_S, 0.0) ** 2
        value += rng.normal(0.0, deviation)
        row = PositionMeasurement(Source.DISTANCE, value, 0.0, deviation**2, 4.0)
        state = bank.advance(state, [row], T0)
        if t > STEADY_S and any(event == "stop" for event, _ in state.events):
            break
    return t - STEADY_S


@pytest.mark.long
@pytest.mark.parametrize("deviation", [0.001, 0.004])
def test_the_law_is_what_the_bank_needs_for_most_stops(deviation: float) -> None:
    delays = sorted(delay(deviation, seed) for seed in range(RUNS))
    law = seen_after(STOP, deviation, T0, BankSettings().perceived)
    assert law == pytest.approx(delays[-2], rel=0.15)
    assert law > delays[RUNS // 2], "half of the stops are seen earlier"


def test_a_finer_or_a_quicker_sensor_and_a_harder_stop_are_seen_earlier() -> None:
    plain = seen_after(STOP, 0.001, T0, 6.0)
    assert seen_after(STOP, 0.0005, T0, 6.0) < plain
    assert seen_after(STOP, 0.001, T0 / 3.0, 6.0) < plain
    assert seen_after(2.0 * STOP, 0.001, T0, 6.0) < plain
