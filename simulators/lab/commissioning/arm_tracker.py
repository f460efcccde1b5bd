"""``linemate-sim measure-arm``: rest poses of an emulated arm as a laser tracker measures them.

Invariants:
    The drives, the link side of the gears and the table are those of a run of the same cell.
    What leaves is what an engineer has: joints as the controller shows them, and measured poses.
    A pose is reached from both sides, each time by all axes in one direction.
"""

from argparse import Namespace
from dataclasses import replace

import numpy as np

from linemate.daemon.core import rotations
from linemate.daemon.core.control import kinematics
from linemate.daemon.core.horizon import Array
from linemate.daemon.identification.geometry.measured_poses import MeasuredPoses, text_of
from linemate.simulators.harness.cell import cell_files
from linemate.simulators.harness.cell.variants import SetupError
from linemate.simulators.harness.setup import Setup, make
from linemate.simulators.plants import rotation
from linemate.simulators.plants.arm import ArmPlant, Values
from linemate.simulators.plants.bending.drives import drives
from linemate.simulators.plants.bending.link_side import link_side, true_links
from linemate.simulators.plants.scenario import Robot
from linemate.simulators.plants.streams import stream

POSES = 40
PLACE_NOISE, TURN_NOISE = 0.03e-3, 0.1e-3  # of a measured pose, each axis [m], [rad]
FRAME_PLACE, FRAME_TURN = 0.05e-3, 0.02e-3  # of the tracker's frame in base, each axis [m], [rad]
HALF_BOX = 0.075  # of the measured places about the object, as a share of the arm's length
TILT, SPIN = 0.35, 1.0  # of the tool across and about its axis [rad]
TRAVEL = (0.0, 3.0)  # of the linear axis [m]
RUN_UP = 0.03  # of each axis to a pose, which winds the gears up all the way [rad]
MOST_TRIES = 100  # for each pose that is within reach
RUN_UP_S, MOVE_S, REST_S = 0.6, 2.0, 2.0
"""Times of an approach, of the way to it, and until a pose is measured [s]."""


def main(args: Namespace) -> int:
    """Measure, and write the table.

    Args:
        args: file, scenario, cell, config, task, overrides, seed, poses, positions.

    Raises:
        SetupError: what was asked for cannot be measured.
    """
    cell = cell_files.chosen(args)
    setup = make(cell_files.scenario(args.scenario, cell), args.overrides, cell=cell)
    poses = measure(setup, args.seed, args.poses, orientation=not args.positions)
    args.file.write_text(text_of(poses), encoding="utf-8")
    print(f"{args.file}: {len(poses.lines)} rows of {args.poses} poses")
    return 0


def measure(
    setup: Setup, seed: int, count: int = POSES, *, orientation: bool = True
) -> MeasuredPoses:
    """Return the poses of a cell's arm as measured.

    Args:
        seed: of the cell, unless the scenario has one of its own; of poses and noise as well.
    """
    scenario = setup.scenario
    cell = seed if scenario.cell_seed is None else scenario.cell_seed
    draws = stream(cell, "tracker")
    frame_place, frame_turn = draws.standard_normal((2, 3))
    frame = rotations.exp(FRAME_TURN * frame_turn)
    stand = _Stand(scenario.robot, scenario.cycle_s, cell)
    rows, positions, turns = [], [], []
    for pose in rest_poses(setup, cell, count):
        for side in (-1.0, 1.0):
            away = pose.copy()
            away[:6] -= side * RUN_UP
            stand.move(away, MOVE_S if side < 0.0 else RUN_UP_S)
            stand.move(pose, RUN_UP_S)
            stand.rest(REST_S)
            joints, (position, turned) = stand.shown(), stand.tcp()
            turn = np.array(turned).reshape(3, 3)
            place_noise, turn_noise = draws.standard_normal((2, 3))
            rows.append(joints)
            seen = frame @ np.array(position) + FRAME_PLACE * frame_place
            positions.append(seen + PLACE_NOISE * place_noise)
            turns.append(frame @ turn @ rotations.exp(TURN_NOISE * turn_noise))
    axes = 7 if setup.task.arm.linear_axis else 6
    return MeasuredPoses(
        tuple(range(2, len(rows) + 2)),
        np.array(rows)[:, :axes],
        np.array(positions),
        np.array(turns) if orientation else None,
    )


def rest_poses(setup: Setup, seed: int, count: int) -> list[Array]:
    """Return joints (7,) whose tcp is in a box about the nominal object, turned about all axes."""
    file, tool = setup.task, setup.task.arm.tcp_in_flange
    arm = kinematics.load(
        setup.urdf,
        file.arm.flange,
        np.array(tool.position),
        rotations.matrix(tool.quaternion),
        linear_axis=file.arm.linear_axis,
    )
    nominal, place = file.object.nominal, stream(seed, "tracker.poses")
    turn, centre = rotations.matrix(nominal.quaternion), np.array(nominal.position)
    rest = np.array((*file.arm.rest_joints, 0.0))[: arm.axes]
    poses: list[Array] = []
    for _ in range(MOST_TRIES * count):
        off = place.uniform(-1.0, 1.0, 3) * HALF_BOX * arm.levers[0]
        tilt = place.uniform(-1.0, 1.0, 3) * (TILT, TILT, SPIN)
        rail = place.uniform(*TRAVEL)
        guess = rest.copy()
        if arm.linear_axis:
            guess[6] = rail
            off = off + turn.T @ (0.0, rail, 0.0)
        try:
            turned = turn @ rotations.exp(tilt)
            joints = arm.solve(guess, centre + turn @ off, turned, tolerance=1e-6)
        except kinematics.UnreachableError:
            continue
        if np.all(joints > arm.lower + RUN_UP) and np.all(joints < arm.upper - RUN_UP):
            poses.append(np.append(joints, np.zeros(7 - arm.axes)))
        if len(poses) == count:
            return sorted(poses, key=lambda joints: float(joints[6]))
    raise SetupError(f"{len(poses)} of {count} poses about the object are within the arm's reach")


class _Stand:
    """An arm alone: drives, gears, and the tcp that they place."""

    def __init__(self, robot: Robot, cycle_s: float, cell: int) -> None:
        self._cycle_s = cycle_s
        self._servos = drives(robot, cycle_s, 1)
        self._links = link_side(robot, cell)
        self._arm = ArmPlant(replace(robot, links=true_links(robot, cell)))
        self._resolution = robot.effects.quantisation
        self._commanded = np.array(robot.start)
        self._cycle = 0
        self._joints: Values = robot.start

    def move(self, goal: Array, duration_s: float) -> None:
        """Go to a pose, at rest at both ends."""
        begin, cycles = self._commanded, max(1, round(duration_s / self._cycle_s))
        for i in range(1, cycles + 1):
            share = i / cycles
            smooth = share**3 * (10.0 - 15.0 * share + 6.0 * share**2)
            self._run(begin + smooth * (goal - begin))

    def rest(self, duration_s: float) -> None:
        """Stay."""
        for _ in range(max(1, round(duration_s / self._cycle_s))):
            self._run(self._commanded)

    def _run(self, setpoints: Array) -> None:
        """Advance by a cycle."""
        self._commanded = setpoints
        self._servos.begin_cycle(self._cycle)
        self._servos.command(self._cycle, 0.0, tuple(setpoints.tolist()))
        self._servos.advance(self._cycle)
        motors, speeds = self._servos.positions, self._servos.velocities
        links = self._links
        self._joints = motors if links is None else links.advance(motors, speeds, self._cycle_s)
        self._cycle += 1

    def shown(self) -> list[float]:
        """Joints as the controller shows them."""
        steps = zip(self._servos.positions, self._resolution, strict=True)
        return [step * round(q / step) if step else q for q, step in steps]

    def tcp(self) -> rotation.Pose:
        """Rigid tcp in base."""
        return self._arm.tcp(self._joints)
