"""Figures of detection: intervals, plans, and the same whatever the number of workers."""

import json
import math

import pytest

from linemate.simulators.harness import setup
from linemate.simulators.harness.main import main
from linemate.simulators.lab import detection
from linemate.simulators.lab.detection import DetectionPlan
from linemate.simulators.lab.detection_runs import Tally


@pytest.mark.parametrize(
    ("count", "low", "high"), [(0, 0.0, 3.6889), (1, 0.0253, 5.5716), (10, 4.7954, 18.3904)]
)
def test_a_rate_has_garwoods_interval(count: int, low: float, high: float) -> None:
    found = detection.rate(count, 1.0)
    assert found == {"rate": count, "ci95": [low, high], "count": count}
    assert detection.rate(count, 20.0)["ci95"][1] == pytest.approx(high / 20.0, abs=1e-4)


def test_no_time_watched_gives_no_rate() -> None:
    assert detection.rate(0, 0.0)["rate"] is None


def test_a_missed_event_is_worse_than_any_latency() -> None:
    found = detection.latencies([0.1] * 18 + [0.2, math.inf])
    assert (found["median"], found["p95"], found["worst"]) == (0.1, 0.2, None)
    assert (found["n"], found["missed"]) == (20, 1)
    assert detection.latencies([0.1] * 9 + [math.inf])["p95"] is None


def test_confusion_is_reported_as_the_share_that_was_not_taken_for_a_stop() -> None:
    tally = Tally()
    tally.pushed.update({"made": 200, "suspected": 20, "taken": 1})
    found = detection.figures("jerk", tally)
    assert found["not_taken"]["share"] == 0.995
    assert found["not_suspected"]["share"] == 0.9
    assert found["not_taken"]["ci95"][0] == pytest.approx(0.9725, abs=1e-3)


def test_a_plan_is_as_long_as_it_was_asked_to_be() -> None:
    made = setup.make("wheel")
    whole = list(DetectionPlan([made, made], 20.0, 1000).runs())
    free = [one for one in whole if one.kind == "free"]
    assert sum(one.duration_s for one in free) == pytest.approx(2 * 20.0 * 3600.0)
    assert {one.seed for one in free} == set(range(1000, 1080))
    jerks = sum(one.duration_s for one in whole if one.kind == "jerk")
    assert jerks == pytest.approx(2 * 200 * 12.1)


def test_detection_prints_the_same_whatever_the_number_of_workers(
    capsys: pytest.CaptureFixture[str],
) -> None:
    made = setup.make("wheel", variant="rule")
    plan = DetectionPlan([made], 0.012, kinds=("jerk", "push"))
    one, other = (json.dumps(detection.execute(plan, workers)) for workers in (1, 2))
    assert one == other
    found = json.loads(one)["detection"]["rule"]
    assert found["jerk"]["made"] == found["push"]["made"] == 2
    assert "slow pushes in contact" in detection.table(json.loads(one))
    assert capsys.readouterr().out == ""


def test_a_campaign_of_detection_prints_json(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["campaign", "--detection", "0.001", "--workers", "1", "--json"]
    assert main([*arguments, "--variants", "rule"]) == 0
    kinds = json.loads(capsys.readouterr().out)["detection"]["rule"]
    assert set(kinds) == {"free", "contact", "restart", "jerk", "push"}


@pytest.mark.parametrize("text", ["0", "-1", "x", "nan", "1e9"])
def test_what_is_no_number_of_hours_is_wrong_usage(text: str) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["campaign", "--detection", text])
    assert caught.value.code == 2
