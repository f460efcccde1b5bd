"""Figures of rounds, which late replies the machine explains, and one short round for real."""

from array import array
from pathlib import Path

import pytest

from linemate.simulators.harness import host
from linemate.simulators.harness.processes import Children
from linemate.simulators.lab.bench import bench_clock, bench_floor, bench_turnaround
from linemate.simulators.lab.bench.bench import record_trace
from linemate.simulators.lab.bench.bench_floor import Place, Spike, TimerProgram
from linemate.simulators.lab.bench.bench_turnaround import (
    PROBE_PERIOD_NS,
    Bench,
    Round,
    figures,
    is_explained,
    percentile,
)

MS = 1_000_000
CYCLE = 4 * MS


def rounds(daemon_us: list[list[int]], echo_us: int = 50) -> list[Round]:
    return [
        Round([n * CYCLE for n in range(len(one))], [1000 * us for us in one],
              [1000 * echo_us] * len(one), 0.0, 1.0)
        for one in daemon_us
    ]  # fmt: skip


def test_a_ratio_is_the_median_of_the_rounds_own_ratios() -> None:
    figure = figures(rounds([[100] * 9, [60] * 9, [5000] * 9]), CYCLE, [])
    assert figure["p50_ratio"] == 2.0
    assert figure["p50_us"] == 100.0
    assert figure["echo_p99_us"] == 50.0
    assert figure["cycles"] == 27
    assert figure["late"] == figure["late_unexplained"] == 9


def test_lateness_of_the_echo_is_kept_apart() -> None:
    took = [50_000, -1, CYCLE + 1, CYCLE]
    figure = figures([Round([0] * 4, [60_000] * 4, took, 0.0, None)], CYCLE, [])
    assert figure["late"] == 0
    assert figure["echo_late"] == 2


def test_a_reply_that_never_came_is_late_and_slower_than_any() -> None:
    one = Round([0, CYCLE], [-1, 60_000], [50_000, 50_000], 0.0, None)
    figure = figures([one], CYCLE, [])
    assert figure["late"] == 1
    assert figure["p99_us"] is None
    assert figure["prepared"] is None
    assert percentile([-1, 5, 7], 0.5) == 7.0


@pytest.mark.parametrize(
    ("due", "woke", "explained"),
    [
        (1 * MS, 4 * MS, True),  # stood still for as long as the reply was late
        (1 * MS, 2 * MS, False),  # for less
        (-9 * MS, -5 * MS, False),  # before it
        (8 * MS, 12 * MS, False),  # after it
        (-2 * MS, 4 * MS, True),  # from before it
    ],
)
def test_the_machine_explains_only_what_it_took(due: int, woke: int, explained: bool) -> None:
    late_by = 3 * MS
    assert is_explained(0, CYCLE + late_by, CYCLE, [Spike(due, woke)]) is explained


def test_without_a_spike_nothing_is_explained() -> None:
    assert not is_explained(0, CYCLE + 1, CYCLE, [])
    assert not is_explained(0, -1, CYCLE, [])


def test_short_spikes_add_up() -> None:
    spikes = [Spike(n * 2 * MS, n * 2 * MS + MS // 2) for n in range(4)]
    took = CYCLE + 4 * (MS // 2 + PROBE_PERIOD_NS)
    assert not is_explained(0, took + 1, CYCLE, spikes[:3])


def test_a_rounds_file_is_three_columns(tmp_path: Path) -> None:
    path = tmp_path / "round"
    path.write_bytes(array("q", [1, 2, 10, 20, 100, -1]).tobytes())
    one = Round.read(path, 5.0, 0.5)
    assert list(one.sent_ns) == [1, 2]
    assert list(one.daemon_ns) == [10, 20]
    assert list(one.echo_ns) == [100, -1]


@pytest.fixture(scope="module")
def program(tmp_path_factory: pytest.TempPathFactory) -> Path:
    found = bench_floor.compiled(tmp_path_factory.mktemp("floor"))
    if found is None:
        pytest.skip("no C compiler")
    return found


def test_without_a_compiler_there_is_no_program(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(bench_floor, "COMPILERS", ("no-such-compiler",))
    assert bench_floor.compiled(tmp_path) is None


def test_the_c_timer_tells_lateness_and_spikes(program: Path, tmp_path: Path) -> None:
    with Children() as children:
        command = bench_floor.c_timer(program, MS, 0)
        timer = TimerProgram(children, command, tmp_path / "timer.log", Place())
        timer.lateness()
        first = len(timer.spikes)
        while timer.lateness().count == 0 or len(timer.spikes) == first:
            pass
        spike = timer.spikes[-1]
        assert 0 < spike.woke_ns - spike.due_ns < 10_000 * MS
        assert all(one.due_ns % MS == 0 for one in timer.spikes)


@pytest.mark.parametrize("now_ns", [0, 1, CYCLE // 2, 987_654_321_012])
def test_the_daemons_clock_wakes_halfway_between_the_c_timers_wakes(now_ns: int) -> None:
    pace = bench_clock.between(CYCLE, now_ns)
    assert pace.wake_ns % CYCLE == CYCLE // 2
    assert abs(pace.wake_ns - now_ns) <= 2 * CYCLE


@pytest.mark.timeout(120)
def test_one_short_round_for_real(program: Path, tmp_path: Path) -> None:
    trace = tmp_path / "trace.json"
    record_trace().write(trace)
    fifo = host.missing_rights() is None
    bench = Bench(trace, program, tmp_path, fifo, 1, 0.1, (0, 0))
    found = bench_turnaround.measure(bench, 12_000, prepared=True, modes=("idle",))
    figure = found.modes["idle"]
    assert figure["cycles"] == bench_turnaround.LEAST_CYCLES
    assert figure["p50_us"] > 0.0
    assert figure["echo_p50_us"] > 0.0
    assert figure["prepared"] > 0.5
    assert found.cpu_per_cycle_us > 10.0
    assert 0.1 < found.start_s < 60.0
    robot = found.status["links"]["robot"]["counters"]
    assert robot["express"] > 0
    assert robot.get("hasty", 0) == 0
