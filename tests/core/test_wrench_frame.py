"""Wrench of the tcp from that of a sensor elsewhere in the tool."""

from dataclasses import replace

import numpy as np
import pytest

from linemate.daemon.config import task_file
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.core import rotations, wrench_frame
from linemate.daemon.core.parameters import build
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import ArmFile, PoseFile
from linemate.protocol.stamped_samples import WrenchSample
from linemate.simulators.harness.setup import shipped_control

TURN, PLACE = np.array((0.3, -1.2, 0.5)), np.array((0.1, -0.2, 0.3))


def frame(sign: int = -1) -> wrench_frame.WrenchFrame:
    w, x, y, z = rotations.quaternion(rotations.exp(TURN))
    a, b, c = PLACE.tolist()
    pose = PoseFile((a, b, c), (w, x, y, z))
    arm = ArmFile((0.0,) * 6, sensor_in_tcp=pose, sensor_sign=1 if sign > 0 else -1)
    found = wrench_frame.of_arm(arm)
    assert found is not None
    return found


def test_a_force_at_the_tcp_is_felt_without_a_torque() -> None:
    R = rotations.exp(TURN)
    force = np.array((10.0, -20.0, 5.0))
    felt, about = -R.T @ force, -R.T @ np.cross(-PLACE, force)
    sample = WrenchSample(1, tuple(felt.tolist()), tuple(about.tolist()), status=3)
    there = wrench_frame.at_tcp(frame(), sample)
    assert there.force == pytest.approx(force)
    assert there.torque == pytest.approx(np.zeros(3), abs=1e-12)
    assert there.status == 3


def test_a_force_of_the_tcp_is_stated_in_the_sensor_as_the_sensor_states_it() -> None:
    sample = WrenchSample(1, (1.0, 2.0, 3.0), (0.0, 0.0, 0.0))
    x, y, z = wrench_frame.at_tcp(frame(), sample).force
    assert wrench_frame.force_in_sensor(frame(), (x, y, z)) == pytest.approx(sample.force)


def test_a_sensor_at_the_tcp_costs_nothing() -> None:
    task = task_file.load(DAEMON_DATA / "wheel.yaml")
    assert wrench_frame.of_arm(task.file.arm) is None
    compiled = build(task.file, task.urdf, TrackingSettings(), shipped_control(), 0.012)
    assert compiled.wrench_frame is None
    arm = replace(task.file.arm, sensor_sign=-1)
    turned = replace(task.file, arm=arm)
    compiled = build(turned, task.urdf, TrackingSettings(), shipped_control(), 0.012)
    assert compiled.wrench_frame is not None
