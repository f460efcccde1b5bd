"""Clock and feed of a daemon's telemetry and samples."""

import threading
import time
from pathlib import Path
from typing import Any

import pytest
from rerun import Rerun, rerun

from linemate.daemon.transport.client import Client
from linemate.daemon.view.channels.daemon_feed import DaemonFeed, WallClock


def test_the_fastest_message_gives_the_offset_of_the_clocks() -> None:
    clock = WallClock()
    assert clock.wall(5) is None
    for stamp_ns, late_ns in ((0, 3_000_000), (1, 400), (2, 9_000_000)):
        clock.update(stamp_ns, 10**18 + stamp_ns + late_ns)
    assert clock.wall(100) == 10**18 + 500


def test_another_daemon_has_another_offset() -> None:
    clock = WallClock()
    clock.update(0, 10**18)
    clock.update(7_000_000_000_000, 10**18 + 40_000_000)
    assert clock.wall(7_000_000_000_000) == 10**18 + 40_000_000


def fed(folder: Path, *, wanted: bool = True) -> tuple[list[str], list[Any], list[Any], list[str]]:
    """What a feed hands over until it has had ten moments."""
    scenes: list[str] = []
    moments: list[Any] = []
    samples: list[Any] = []
    troubles: list[str] = []
    done = threading.Event()

    def on_moment(telemetry: Any, wall_ns: int) -> None:
        moments.append((telemetry, wall_ns))
        if len(moments) >= 10:
            done.set()

    feed = DaemonFeed(
        lambda: Client.local(folder / "command.sock"),
        lambda scene: scenes.append(str(scene["task"])),
        on_moment,
        lambda answer, _: samples.append(answer),
        lambda: wanted,
        troubles.append,
    )
    feed.start()
    try:
        done.wait(10.0 if (folder / "command.sock").exists() else 0.2)
    finally:
        feed.end()
    return scenes, moments, samples, troubles


def test_scene_moments_and_samples_of_a_daemon_are_handed_over(tmp_path: Path) -> None:
    rerunning = Rerun(1.0, 5.0)
    with rerun(tmp_path, rerunning):
        scenes, moments, samples, troubles = fed(tmp_path)
    assert len(scenes) == 1
    assert len(moments) >= 10
    assert abs(moments[-1][1] - time.time_ns()) < 5_000_000_000
    assert len(samples[0]["wrench"]) == 6
    assert not troubles


def test_a_daemon_is_not_asked_for_samples_that_no_client_wants(tmp_path: Path) -> None:
    rerunning = Rerun(1.0, 5.0)
    with rerun(tmp_path, rerunning):
        _, moments, samples, _ = fed(tmp_path, wanted=False)
    assert len(moments) >= 10
    assert not samples
    assert "sensors" not in rerunning.asked


@pytest.mark.timeout(20)
def test_a_daemon_that_does_not_answer_is_reported(tmp_path: Path) -> None:
    *nothing, troubles = fed(tmp_path)
    assert not any(nothing)
    assert any("command.sock" in trouble for trouble in troubles)
