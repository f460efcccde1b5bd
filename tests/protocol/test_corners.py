"""Branches of the codecs that everyday telegrams never take."""

import math
from pathlib import Path

import pytest

from linemate.protocol.distance import DistanceEncoder, DistanceError
from linemate.protocol.exchange import Exchange
from linemate.protocol.rsi import RobotTelegram, RsiCodec, RsiError, SensorTelegram, parse_config

SHIPPED = (Path(__file__).resolve().parents[2] / "protocol/data/rsi_joints.xml").read_bytes()
SIX = (0.1, -0.2, 0.3, -0.4, 0.5, -0.6)


def test_more_senders_than_are_remembered_are_written_all_the_same() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    for n in range(20):
        data = codec.format_sensor(
            SensorTelegram(7, sentype=f"S{n}", joints=SIX, external=(0.1,), channels={"DiO": 0})
        )
        assert data.startswith(b'<Sen Type="S%d">' % n)
        assert data == codec.format_sensor(
            SensorTelegram(7, sentype=f"S{n}", joints=SIX, external=(0.1,), channels={"DiO": 0})
        )


@pytest.mark.parametrize("wild", [math.nan, math.inf, -math.inf, 1e13])
@pytest.mark.parametrize("spare", [(), (0.0,), (0.5,)])
def test_a_correction_that_no_wire_carries_is_refused_whatever_stands_beside_it(
    wild: float, spare: tuple[float, ...]
) -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    with pytest.raises(RsiError):
        codec.format_sensor(SensorTelegram(7, joints=SIX, external=(wild, *spare)))
    with pytest.raises(RsiError):
        codec.format_sensor(SensorTelegram(7, joints=(wild, *SIX[1:]), external=(0.0,)))


def test_axes_without_an_element_may_be_zero_and_nothing_else() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    codec.format_sensor(SensorTelegram(7, joints=SIX, external=(0.1, 0.0, 0.0)))
    with pytest.raises(RsiError, match="not in the configuration"):
        codec.format_sensor(SensorTelegram(7, joints=SIX, external=(0.1, 0.0, 0.2)))


def test_nothing_is_expected_of_a_delay_that_is_not_known() -> None:
    codec = RsiCodec(parse_config(SHIPPED))
    codec.parse_robot(
        codec.format_robot(RobotTelegram(12, joints=SIX, external=SIX, tcp=SIX, delay=0))
    )
    assert codec.expect_robot(24, None, SIX, 0.05) is None
    assert codec.expect_robot(24, 0, SIX, 0.05) is not None


def test_a_distance_beyond_its_place_is_refused() -> None:
    for value in (1e6, -1.0, math.nan):
        with pytest.raises(DistanceError):
            DistanceEncoder().encode(value)
    with pytest.raises(DistanceError):
        DistanceEncoder(message="TF03", signal="Distance", strength="Strength").encode(1.0, 1e6)


def test_the_telegram_that_is_foreseen_is_the_one_that_comes() -> None:
    exchange = Exchange(0.012)
    assert exchange.foreseen() is None
    for k in range(5):
        exchange.on_telegram(1000 + 12 * k, k * 12_000_000, "robot")
    assert exchange.foreseen() == (1060, "robot")
    exchange.on_missing()
    assert exchange.foreseen() is None
    assert exchange.on_telegram(1060, 60_000_000, "robot").answer
