"""Tables of the bench: ratios with the times that they compare, and what falls short."""

from typing import Any

from docs.make import bench_results

MACHINE = {"processor": "P", "cores": 2, "kernel": "6", "python": "3.11", "load_1min": 0.5}


def mode(p50_ratio: float, late: int) -> dict[str, Any]:
    return {
        "p50_us": 60.0, "echo_p50_us": 40.0, "p50_ratio": p50_ratio,
        "p99_us": 90.0, "echo_p99_us": 60.0, "p99_ratio": 1.4, "late": late, "cycles": 4000,
    }  # fmt: skip


RESULTS: dict[str, Any] = {
    "turnaround": {
        "machine": MACHINE,
        "turnaround": {
            "4ms": {"idle": mode(1.1, 0), "loaded": mode(1.5, 0), "inline": mode(5.0, 0)},
            "2ms": {"idle": mode(1.1, 2), "loaded": mode(1.5, 4), "inline": mode(7.0, 0)},
        },
    }
}


def test_replies_are_shown_next_to_those_of_the_echo() -> None:
    head, _, p50, p99, inline, answered = bench_results.turnaround(RESULTS.__getitem__).splitlines()
    assert head == (
        "| P, 2 cores, Linux 6, Python 3.11, load 0.5"
        " | 4 ms, idle | 4 ms, loaded | 2 ms, idle | 2 ms, loaded |"
    )
    assert p50.startswith("| reply by echo, p50 | 1.1 (60/40 us) | 1.5 (60/40 us) |")
    assert p99.startswith("| reply by echo, p99 | 1.4 (90/60 us) |")
    assert inline == "| not prepared, p50 | 5 (60/40 us) |  | 7 (60/40 us) |  |"
    # By hand: 2 and 4 of 4000 are 0.05 and 0.1 %.
    assert answered == "| answered in their cycle | 100 % | 100 % | 99.95 % | 99.9 % |"


def test_what_falls_short_of_its_limit_is_named_and_no_other() -> None:
    assert list(bench_results.missed_turnarounds(RESULTS["turnaround"]["turnaround"])) == [
        ("4 ms, loaded: reply by echo, p50", "1.5", "1.3"),
        ("2 ms, loaded: answered in their cycle", "99.9 %", "99.95 %"),
    ]
