"""A trace of a station is played at any cycle time."""

import itertools
from importlib.resources import files
from pathlib import Path

import pytest

from linemate.protocol.rsi.codec import RsiCodec, SensorTelegram, parse_config
from linemate.simulators.lab.bench import bench_player
from linemate.simulators.lab.bench.bench_trace import DISTANCE_NS, StationTrace

MS = 1_000_000
XML = files("linemate.protocol").joinpath("data", "rsi_joints.xml").read_bytes()


def trace(cycles: int = 10) -> StationTrace:
    """A robot whose joints and axis rise by 1 a ms, and its sensors."""
    return StationTrace(
        robot=[(12 * MS * k, *(12.0 * k,) * 7, k // 5) for k in range(cycles)],
        distance=[(12 * MS * k + 2 * MS, 1.0 + 0.012 * k) for k in range(cycles)],
        camera=[(25 * MS * k, 25 * MS * k - 90 * MS, (0.1, 0.2, 0.7), (1.0, 0.0, 0.0, 0.0), None)
                for k in range(4)],
        wrench=[(4 * MS * k, (1.0, 2.0, 3.0), (0.1, 0.2, 0.3)) for k in range(3 * cycles)],
    )  # fmt: skip


def test_between_two_telegrams_the_robot_is_on_the_line_between_them() -> None:
    axes, signals = trace().axes(30 * MS)
    assert axes == (30.0,) * 7
    assert signals == 0
    assert trace().axes(60 * MS) == ((60.0,) * 7, 1)
    assert trace().axes(0)[0] == (0.0,) * 7


def test_beyond_its_end_the_robot_stays() -> None:
    assert trace().axes(10_000 * MS)[0] == (108.0,) * 7


def test_the_distance_sensor_speaks_once_a_cycle_and_no_faster_than_it_can() -> None:
    for cycle in (12 * MS, 4 * MS, MS):
        rows = trace().thinned(cycle)
        steps = {b[0] - a[0] for a, b in itertools.pairwise(rows)}
        assert steps == {max(cycle, DISTANCE_NS)}
        for at, reading in rows:
            assert reading == pytest.approx(1.0 + 0.001 * (at - 2 * MS) / MS)


def test_a_trace_comes_back_from_its_file(tmp_path: Path) -> None:
    path = tmp_path / "trace.json"
    trace().write(path)
    again = StationTrace.read(path)
    assert again.axes(30 * MS) == trace().axes(30 * MS)
    assert again.length_ns == trace().length_ns == 108 * MS


def test_the_players_robot_goes_where_it_is_sent_and_the_daemons_codec_reads_it() -> None:
    codec = RsiCodec(parse_config(XML))
    arm = bench_player.PlayedRobot(trace())
    reply = SensorTelegram(ipoc=1, joints=(0.1, 0.0, 0.0, 0.0, 0.0, -0.2), external=(0.3,))
    arm.follow(codec.format_sensor(reply))
    arm.follow(None)
    telegram = codec.parse_robot(arm.telegram(100_000_020, 60 * MS))
    assert telegram.ipoc == 100_000_020
    assert telegram.joints == pytest.approx((0.1, 0.0, 0.0, 0.0, 0.0, -0.2))
    assert telegram.external is not None
    assert telegram.external[0] == pytest.approx(0.3)
    assert telegram.channels["DiL"] == 1
    arm.rest()
    assert codec.parse_robot(arm.telegram(1, 0)).joints == pytest.approx((0.0,) * 6)
