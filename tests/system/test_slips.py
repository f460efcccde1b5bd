"""Forty slips of unit or sign in a good site: each is refused, or the tcp stays slow.

A slip that ``linemated --check`` passes is run in virtual time: the daemon uses it,
the plant is as it always was.
"""

import contextlib
import math
import re
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from linemate.daemon.commissioning import whole_check
from linemate.daemon.config.config import LoadedConfig, load
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import DAEMON_DATA
from linemate.daemon.cycle.states import State
from linemate.simulators.harness import lockstep, setup
from linemate.simulators.harness.cell.variants import SetupError

FASTEST = 0.6
"""True speed of the tcp that a slip may lead to [m/s]."""

QUARTER = 0.7071067811865476


@dataclass
class Site:
    """The files of a good site, as plain values and text.

    Attributes:
        config, task: plain values, before they are written.
    """

    config: dict[str, Any]
    task: dict[str, Any]
    urdf: str

    def write(self, folder: Path) -> Path:
        path = folder / "linemated.yaml"
        self.task["arm"]["urdf"] = "site.urdf"
        (folder / "task.yaml").write_text(yaml.safe_dump(self.task), encoding="utf-8")
        (folder / "site.urdf").write_text(self.urdf, encoding="utf-8")
        path.write_text(yaml.safe_dump(self.config), encoding="utf-8")
        return path


def good() -> Site:
    """Return the shipped cell, its limits written out as a site would."""
    rows = [
        {name: getattr(row, name) for name in ("lower", "upper", "speed", "acceleration", "jerk")}
        for row in setup.shipped_control().limits
    ]
    config = {
        "task": "task.yaml",
        "rsi": {"config": "rsi_joints.xml", "port": 49152},
        "distance": {"can": {"interface": "virtual"}},
        "camera": {"port": 49153},
        "control": {"limits": rows},
    }
    task = yaml.safe_load((DAEMON_DATA / "wheel.yaml").read_text(encoding="utf-8"))
    return Site(config, task, (DAEMON_DATA / "arm.urdf").read_text(encoding="utf-8"))


Slip = Callable[[Site], None]


def task(value: Any, *path: str | int) -> Slip:
    return lambda site: _put(site.task, value, path)


def config(value: Any, *path: str | int) -> Slip:
    return lambda site: _put(site.config, value, path)


def times(factor: float, *path: str | int) -> Slip:
    """A value of the task times a factor, or each of a list."""

    def slip(site: Site) -> None:
        branch: Any = site.task
        for part in path:
            branch = branch[part]
        many = [factor * one for one in branch] if isinstance(branch, list) else factor * branch
        _put(site.task, many, path)

    return slip


def limits(factor: float, *names: str) -> Slip:
    def slip(site: Site) -> None:
        for row in site.config["control"]["limits"][:6]:
            for name in names:
                row[name] *= factor

    return slip


def all_times(factor: float) -> Slip:
    def slip(site: Site) -> None:
        for point in site.task["waypoints"]:
            point["time"] *= factor

    return slip


def urdf(old: str, new: str) -> Slip:
    def slip(site: Site) -> None:
        assert old in site.urdf
        site.urdf = site.urdf.replace(old, new, 1)

    return slip


def _put(tree: Any, value: Any, path: tuple[str | int, ...]) -> None:
    for part in path[:-1]:
        tree = tree.setdefault(part, {}) if isinstance(tree, dict) else tree[part]
    tree[path[-1]] = value


DEGREES = 57.29577951308232
POSE = ("pose", "position")
CAMERA = ("arm", "camera_in_tcp")
A2 = '<axis xyz="0 1 0"/>\n    <limit lower="-2.44'
SLIPS: dict[str, Slip] = {
    "conveyor in mm/s": task(106.0, "conveyor", "nominal_speed"),
    "conveyor divided by 60": times(1.0 / 60.0, "conveyor", "nominal_speed"),
    "conveyor backwards": task(-0.106, "conveyor", "nominal_speed"),
    "deceleration in mm/s^2": task(104.0, "conveyor", "deceleration"),
    "deceleration signed": task(-0.104, "conveyor", "deceleration"),
    "acceleration in mm/s^2": task(13.0, "conveyor", "acceleration"),
    "axis of the conveyor backwards": task([0.0, -1.0, 0.0], "conveyor", "axis"),
    "start in mm": task(1000.0, "conveyor", "start_position"),
    "start backwards": task(-1.0, "conveyor", "start_position"),
    "object in mm": times(1000.0, "object", "nominal", "position"),
    "object in cm": times(100.0, "object", "nominal", "position"),
    "object 12 m away": task([12.0, 0.0, 1.1], "object", "nominal", "position"),
    "object behind the robot": task([-2.2, 0.0, 1.1], "object", "nominal", "position"),
    "object below the floor": task([2.2, 0.0, -1.1], "object", "nominal", "position"),
    "object faces away": task([QUARTER, 0.0, -QUARTER, 0.0], "object", "nominal", "quaternion"),
    "quaternion with w last": task([0.0, QUARTER, 0.0, QUARTER], "object", "nominal", "quaternion"),
    "rest in degrees": times(DEGREES, "arm", "rest_joints"),
    "rest signed otherwise": times(-1.0, "arm", "rest_joints"),
    "tool in mm": times(1000.0, "arm", "tcp_in_flange", "position"),
    "tool on the other side": times(-1.0, "arm", "tcp_in_flange", "position"),
    "camera in cm": times(10.0, "arm", "camera_in_tcp", "position"),
    "camera in mm": times(1000.0, "arm", "camera_in_tcp", "position"),
    "camera on the other side": times(-1.0, "arm", "camera_in_tcp", "position"),
    "camera 10 m away": task([-0.1, 0.0, -10.0], *CAMERA, "position"),
    "blind in half a metre": config(0.5, "tracking", "camera", "blind_below"),
    "approach up to the surface": task([0.0, 0.0, 0.0], "waypoints", 1, *POSE),
    "retreat from a closed clamp": task("none", "waypoints", 7, "gate"),
    "clamp opens with loose screws": task("none", "waypoints", 5, "gate"),
    "pull at the closed clamp": task([0.0, 0.0, -0.1], "waypoints", 6, *POSE),
    "end at the object": task([0.0, 0.0, 0.0], "waypoints", 9, *POSE),
    "touch felt at the overload": config(340.0, "tracking", "tactile", "contact_force"),
    "overload in mN": config(10_000.0, "tracking", "tactile", "overload_force"),
    "first waypoint out of reach": task([4.8, 0.0, 1.1], "waypoints", 0, *POSE),
    "waypoint in mm": task([0.0, 0.0, -250.0], "waypoints", 1, *POSE),
    "waypoint in cm": task([0.0, 0.0, -25.0], "waypoints", 1, *POSE),
    "waypoint beyond the object": task([0.0, 0.0, 0.25], "waypoints", 1, *POSE),
    "contact in mm": task([0.0, 0.0, 1.0], "waypoints", 3, *POSE),
    "retreat into the object": task([0.0, 0.0, 0.30], "waypoints", 8, *POSE),
    "times in ms": all_times(1000.0),
    "times in minutes": all_times(1.0 / 60.0),
    "order of the tool in ms": task(8500.0, "tool", "fix_screws"),
    "travel in per cent": task(100.0, "linear_axis", "travel"),
    "travel backwards": task(-1.0, "linear_axis", "travel"),
    "ramp in ms": task(1000.0, "linear_axis", "ramp"),
    "limits in degrees": limits(DEGREES, "lower", "upper", "speed", "acceleration", "jerk"),
    "speeds in degrees": limits(DEGREES, "speed"),
    "positions in degrees": limits(DEGREES, "lower", "upper"),
    "positions signed otherwise": limits(-1.0, "lower", "upper"),
    "rail in mm": config(6000.0, "control", "limits", 6, "upper"),
    "rail's speed in mm/s": config(1500.0, "control", "limits", 6, "speed"),
    "speed a little wider than the robot's": config(3.1, "control", "limits", 3, "speed"),
    "tcp limit in mm/s": config(500.0, "control", "tcp_speed"),
    "dead time in ms": config(
        [{"frequency_hz": 4.0, "damping": 0.8, "dead_time": 36.0}] * 7, "control", "servos"
    ),
    "servos in 1/rad": config(
        [{"frequency_hz": 0.64, "damping": 0.8, "dead_time": 0.036}] * 7, "control", "servos"
    ),
    "tool's modes in 1/rad": config([{"frequency_hz": 0.8}] * 6, "control", "effector"),
    "log odds of a stop signed otherwise": config(-100.0, "tracking", "bank", "stop_confirmed"),
    "centre of the payload in cm": config(
        {"mass": 15.0, "centre": [0.0, 0.0, 10.0]}, "tracking", "payload"
    ),
    "turning stiffness in Nm per degree": config(
        [35.0, 35.0, 35.0], "tracking", "tactile", "rotational_stiffness"
    ),
    "stiffness in N/mm": config([50.0, 50.0, 50.0], "tracking", "tactile", "stiffness"),
    "swing's lever in mm": config(
        [{"axis": 1, "frequency_hz": 0.62, "levers": [-300.0, 0.0, -900.0]}], "tracking", "swing"
    ),
    "swing's lever signed otherwise": config(
        [{"axis": 1, "frequency_hz": 0.62, "levers": [0.3, 0.0, 0.9]}], "tracking", "swing"
    ),
    "link watch in ms": config(100.0, "watch", "link_lost_s"),
    "position watch for ever": config(1e9, "watch", "position_s"),
    "wrench watch in ms": config(160.0, "watch", "wrench_s"),
    "near in mm": config(30.0, "watch", "near_m"),
    "following error in mm": config(10.0, "watch", "follow_tolerance"),
    "distance sensor in mm": config(0.1, "distance", "step_m"),
    "counts of 10 mm as of 0.1 mm": config(
        {"can": {"interface": "virtual"}, "message": "TF03", "signal": "Distance"}, "distance"
    ),
    "two links on one port": config(49152, "camera", "port"),
    "urdf's limit in degrees": urdf('lower="-3.2288591161895095"', 'lower="-185"'),
    "urdf's speed in degrees": urdf('velocity="1.8325957145940461"', 'velocity="105"'),
    "urdf's length in mm": urdf('xyz="0 0 0.675"', 'xyz="0 0 675"'),
    "urdf's axis turned": urdf(A2, A2.replace("0 1 0", "0 -1 0")),
    "urdf's rail turned": urdf('<axis xyz="0 1 0"/>', '<axis xyz="0 -1 0"/>'),
    "urdf's rail in mm": urdf('upper="6.0"', 'upper="6000"'),
}


PASSED = {"start backwards", "camera on the other side", "swing's lever signed otherwise"}
"""Slips that no file shows by itself."""


def checked(path: Path) -> LoadedConfig:
    """Do what ``linemated --check`` does.

    Raises:
        FileError: what it refuses.
    """
    station = load(path)
    whole_check.rehearsed(station.task, whole_check.compile_task(station, station.task))
    return station


def next_to_plant(station: LoadedConfig, cycle_ms: int = 12) -> lockstep.Lockstep:
    """Return a run of the site's daemon next to the shipped plant."""
    known = setup.make("wheel", cycle_ms=cycle_ms)
    identified = known.control
    settings_of = station.config
    control = replace(settings_of.control, servos=identified.servos, effector=identified.effector)
    if settings_of.control.servos != setup.shipped_control().servos:
        control = replace(control, servos=settings_of.control.servos)
    site = replace(
        known,
        task=station.task.file,
        urdf=station.task.urdf,
        tracking=settings_of.tracking,
        control=control,
    )
    return lockstep.Lockstep(site, 0)


def true_speed(station: LoadedConfig) -> float:
    """Run the site's daemon next to the shipped plant; the fastest true tcp [m/s]."""
    return fastest(next_to_plant(station))


def fastest(run: lockstep.Lockstep, until_s: float = math.inf) -> float:
    """Run up to a time; the fastest true tcp [m/s]."""
    with contextlib.suppress(SetupError):
        while run.world.time_s < until_s and run.turn():
            pass
    evidence = run.evidence()
    way = np.linalg.norm(np.diff(evidence.rows.tcp[:, :3], axis=0), axis=1)
    return float(np.nanmax(way)) / evidence.cycle_s if len(way) else 0.0


def test_there_are_forty_slips() -> None:
    assert len(SLIPS) >= 40


def test_the_good_site_is_good_and_slow(tmp_path: Path) -> None:
    speed = true_speed(checked(good().write(tmp_path)))
    assert 0.2 < speed < 0.4


@pytest.mark.row
@pytest.mark.parametrize("name", SLIPS)
def test_a_slip_is_refused_or_the_tcp_stays_slow(name: str, tmp_path: Path) -> None:
    site = good()
    SLIPS[name](site)
    station = None
    with contextlib.suppress(FileError):
        station = checked(site.write(tmp_path))
    assert (station is None) is (name not in PASSED)
    if station is not None:
        assert true_speed(station) < FASTEST


@pytest.mark.row
@pytest.mark.parametrize("cycle_ms", [12, 4])
@pytest.mark.parametrize("axis", ["A1", "A4", "A6"])
def test_an_axis_that_counts_the_other_way_is_held_in_its_first_motion(
    axis: str, cycle_ms: int, tmp_path: Path
) -> None:
    """No file shows it: at 0 the axis is where it should be. A1 went on to an overload."""
    site = good()
    head, joint, tail = site.urdf.partition(f'<joint name="{axis}"')
    sign = re.compile(r'(?<=<axis xyz=")(-?[01]) (-?[01]) (-?[01])')
    turned = sign.sub(lambda xyz: " ".join(str(-int(each)) for each in xyz.groups()), tail, count=1)
    site.urdf = head + joint + turned
    run = next_to_plant(checked(site.write(tmp_path)), cycle_ms)
    assert fastest(run, 2.0) < 0.4
    assert run.cycle.machine.state is State.HOLD
    assert "contradict" in (run.cycle.operating.cause or "")


@pytest.mark.parametrize(
    ("name", "complaint"),
    [
        ("conveyor in mm/s", "conveyor.nominal_speed: "),
        ("object 12 m away", "does not reach the pose"),
        ("object below the floor", "Check the units of times and positions"),
        ("two links on one port", "camera.port: 49152 is rsi.port's already"),
        ("position watch for ever", "watch.position_s: "),
        ("speed a little wider than the robot's", "control.limits[3].speed: 3.1 is wider than"),
        ("first waypoint out of reach", "arm.rest_joints: with these joints"),
    ],
)
def test_the_process_refuses_and_says_where(name: str, complaint: str, tmp_path: Path) -> None:
    site = good()
    SLIPS[name](site)
    done = subprocess.run(
        [
            *(sys.executable, "-m", "linemate.daemon.service.main"),
            *("--config", str(site.write(tmp_path)), "--check"),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 78
    assert complaint in done.stderr


def test_the_process_says_of_a_good_site_how_fast_it_is(tmp_path: Path) -> None:
    done = subprocess.run(
        [
            *(sys.executable, "-m", "linemate.daemon.service.main"),
            *("--config", str(good().write(tmp_path)), "--check"),
        ],
        capture_output=True,
        text=True,
        check=False,
        timeout=60,
    )
    assert done.returncode == 0, done.stderr
    first, *peaks = done.stdout.splitlines()
    assert first.endswith(": good")
    assert [line.partition(":")[0] for line in peaks] == ["tcp", *setup_axes()]
    assert "limit 0.455" in peaks[0]


def setup_axes() -> list[str]:
    return ["A1", "A2", "A3", "A4", "A5", "A6", "E1"]
