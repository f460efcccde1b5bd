"""What an announced stop adds to the odds of its onsets, and which edges count."""

import math

import numpy as np
import pytest

from linemate.daemon.core.tracking.classifiers import stop_input
from linemate.daemon.core.tracking.classifiers.classifier_bank import BankClassifier
from linemate.daemon.core.tracking.conveyor import PositionMeasurement, Source
from linemate.daemon.core.tracking.settings import BankSettings, FusionSettings
from linemate.daemon.core.tracking.task import ConveyorClasses, StopInput

WIRED = StopInput(bit=4, before=0.05, after=0.03)
AGES = np.arange(1, 60) * 0.012


def test_the_onsets_that_an_edge_allows_share_its_weight() -> None:
    odds = stop_input.onset_odds(WIRED, 0.2, AGES)
    assert odds is not None
    allowed = odds != 0.0
    assert AGES[allowed].min() >= 0.2 - 0.03
    assert AGES[allowed].max() <= 0.2 + 0.05
    assert np.exp(odds[allowed]).sum() == pytest.approx(math.exp(WIRED.weight))


def test_without_an_edge_or_an_onset_there_are_no_odds() -> None:
    assert stop_input.onset_odds(WIRED, math.inf, AGES) is None
    assert stop_input.onset_odds(WIRED, 0.2, np.zeros(0)) is None
    assert stop_input.onset_odds(WIRED, 5.0, AGES) is None


def test_only_a_rising_edge_counts() -> None:
    assert stop_input.edge_age(WIRED, math.inf, 0, 16) == 0.0
    assert stop_input.edge_age(WIRED, math.inf, 16, 16) == math.inf
    assert stop_input.edge_age(WIRED, math.inf, -1, 16) == math.inf, "set from the beginning"
    assert stop_input.edge_age(WIRED, math.inf, 16, 0) == math.inf
    assert stop_input.edge_age(WIRED, math.inf, 0, 3) == math.inf, "the tool's bits"


def test_a_bit_that_chatters_or_is_not_wired_announces_nothing_more() -> None:
    assert stop_input.edge_age(WIRED, 0.4, 0, 16) == 0.4
    assert stop_input.edge_age(StopInput(), math.inf, 0, 16) == math.inf
    assert stop_input.edge_age(WIRED, 2.0, 0, None) == 2.0


@pytest.mark.parametrize(("deviation", "counted_s"), [(0.00038, 0.3), (0.002, 0.44)])
def test_an_edge_counts_until_the_distance_sensor_can_show_the_stop(
    deviation: float, counted_s: float
) -> None:
    counted = stop_input.counted_for(ConveyorClasses(deceleration=0.104), deviation)
    assert counted == pytest.approx(counted_s, abs=0.01)


def test_an_edge_does_not_expire_without_a_reading() -> None:
    line, T0, sigma, now = ConveyorClasses(stop_input=WIRED), 0.012, 0.002, np.zeros(1)
    bank = BankClassifier(line, FusionSettings(), BankSettings(), sigma)

    def reading(t: float) -> list[PositionMeasurement]:
        way = line.nominal_speed * t
        return [PositionMeasurement(Source.DISTANCE, way, 0.001, sigma**2, 4.0)]

    state = bank.initial(0.0)
    for k in range(1, 250):
        state = bank.advance(state, reading(k * T0), T0)
    state = bank.announce_stop(state)
    ways = []
    for _ in range(60):
        state = bank.advance(state, (), T0)
        ways.append(float(bank.predict_positions(state, now)[0]))
    assert math.isfinite(state.announced_s)
    # A blind tool whose target jumped by 4 mm swung with 358 N.
    assert np.abs(np.diff(ways, 2)).max() < 1e-4
    state = bank.advance(state, reading(310 * T0), T0)
    assert state.announced_s == math.inf


def test_an_announcement_moves_the_target_by_half_of_what_readings_cannot_show_yet() -> None:
    """A false edge moved it by 5 mm with 1 cm resolution: 268 N, and a missed hub."""
    line, T0, sigma = ConveyorClasses(stop_input=WIRED), 0.012, 0.004
    bank = BankClassifier(line, FusionSettings(), BankSettings(), sigma)
    state, ahead_s = bank.initial(0.0), 0.2

    def row(t: float) -> list[PositionMeasurement]:
        way = line.nominal_speed * t
        return [PositionMeasurement(Source.DISTANCE, way, 0.0, sigma**2, 4.0)]

    for k in range(1, 250):
        state = bank.advance(state, row(k * T0), T0)
    ahead, quiet, state, lost = np.array([ahead_s]), state, bank.announce_stop(state), []
    for k in range(250, 275):
        quiet, state = (bank.advance(each, row(k * T0), T0) for each in (quiet, state))
        way = bank.predict_positions(quiet, ahead) - bank.predict_positions(state, ahead)
        lost.append(float(way[0]))
    half = 0.5 * stop_input.decided_way(line, sigma, T0)
    assert half == pytest.approx(2.5e-3, abs=1e-4)
    assert 0.8 * half < max(lost) < half + 1e-4


def test_an_announcement_that_a_mount_bears_is_not_bounded_by_the_readings() -> None:
    """With steps of 1 mm it was worth nothing: 1.33 instead of 0.62 mm after a stop."""
    line, T0, sigma = ConveyorClasses(stop_input=WIRED), 0.012, 0.0004
    bank = BankClassifier(line, FusionSettings(), BankSettings(), sigma)
    assert stop_input.decided_way(line, sigma, T0) < 0.5 * stop_input.BORNE
    state, ahead_s = bank.initial(0.0), 0.2

    def row(t: float) -> list[PositionMeasurement]:
        at = line.nominal_speed * t
        return [PositionMeasurement(Source.DISTANCE, at, 0.001, sigma**2, 4.0)]

    for k in range(1, 250):
        state = bank.advance(state, row(k * T0), T0)
    quiet, state = state, bank.announce_stop(state)
    for k in range(250, 254):
        quiet, state = (bank.advance(each, row(k * T0), T0) for each in (quiet, state))
    ahead = np.array([ahead_s])
    way = bank.predict_positions(quiet, ahead) - bank.predict_positions(state, ahead)
    assert float(way[0]) > 0.5 * stop_input.BORNE


def test_readings_decide_once_their_evidence_is_the_weight_of_an_edge() -> None:
    line, sigma, T0 = ConveyorClasses(stop_input=WIRED), 0.002, 0.001
    decided_s = math.sqrt(2.0 * stop_input.decided_way(line, sigma, T0) / line.deceleration)
    ways = 0.5 * line.deceleration * np.arange(0.0, decided_s, T0) ** 2
    assert 0.5 * float(ways @ ways) / sigma**2 == pytest.approx(WIRED.weight, rel=0.05)
