"""Figures of the links from made inputs."""

import numpy as np
import pytest

from linemate.daemon.commissioning.link_figures import find_links
from linemate.daemon.config.watch_settings import WatchSettings
from linemate.daemon.core.inputs import Inputs
from linemate.daemon.identification.outcome import Estimate, Outcome, Refusal
from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)

ALL = ("distance", "camera", "force_torque")


def inputs(
    *, silent: tuple[float, float] = (9.0, 9.0), late_ms: float = 100.0, delays: int = 0
) -> list[Inputs]:
    """Five seconds of all sensors; none sends between two times."""
    rng = np.random.default_rng(1)
    made = []
    for k in range(416):
        t, stamp = 0.012 * k, 12_000_000 * k
        robot = RobotSample(stamp, k, (0.0,) * 6, (0.0,), delay=delays * k // 415)
        if silent[0] <= t < silent[1]:
            made.append(Inputs(k, stamp, robot))
            continue
        noise = rng.normal(0.0, 1.0, 3)
        x, y, z = (1e-3 * noise).tolist()
        exposure = stamp - round(late_ms * 1e6)
        image = CameraSample(
            stamp, exposure, "c", "camera", "hub", k, (x, y, z), (1.0, 0.0, 0.0, 0.0)
        )
        a, b, c = (5.0 * noise).tolist()
        made.append(
            Inputs(
                k, stamp, robot, (DistanceSample(stamp, 0.1 * t + x),), (image,),
                (WrenchSample(stamp, (a, b, c), (0.0, 0.0, 0.0)),),
            )
        )  # fmt: skip
    return made


def found(made: list[Inputs]) -> dict[str, Outcome]:
    return {line.name: line.outcome for line in find_links(made, WatchSettings(), ALL)}


def value(outcome: Outcome) -> float:
    assert isinstance(outcome, Estimate), outcome
    return outcome.value


def test_rate_noise_and_age_of_each_link_are_shown() -> None:
    lines = found(inputs())
    assert value(lines["robot telegrams"]) == pytest.approx(83.33, abs=0.01)
    assert value(lines["distance rate"]) == pytest.approx(83.33, abs=0.1)
    assert value(lines["distance noise"]) == pytest.approx(1e-3, rel=0.2)
    assert value(lines["force_torque noise"]) == pytest.approx(5.0, rel=0.2)
    assert value(lines["camera age"]) == pytest.approx(0.1)


def test_a_gap_beyond_the_time_out_is_refused() -> None:
    outcome = found(inputs(silent=(2.0, 2.3)))["force_torque longest gap"]
    assert isinstance(outcome, Refusal)
    assert "time-out 0.160 s" in outcome.reason


def test_a_device_without_samples_is_refused() -> None:
    made = [Inputs(x.k, x.stamp_ns, x.robot, x.distance) for x in inputs()]
    outcome = found(made)["camera"]
    assert isinstance(outcome, Refusal)
    assert outcome.reason.startswith("0 samples")


def test_an_exposure_after_its_arrival_is_refused() -> None:
    assert isinstance(found(inputs(late_ms=-3.0))["camera age"], Refusal)


def test_late_replies_are_refused() -> None:
    outcome = found(inputs(delays=4))["robot late replies"]
    assert isinstance(outcome, Refusal)
    assert "counted 4 late replies" in outcome.reason


def test_a_short_recording_judges_no_link() -> None:
    assert isinstance(found(inputs()[:50])["links"], Refusal)
