"""The multibody model of a run in MuJoCo: where its parts are, and what its joints carry.

Invariants:
    MuJoCo's arrays are reached here and in ``world`` alone.
    At the start arm, mount and conveyor are in equilibrium; the body swings from before.
"""

import math

import mujoco
import numpy as np

from linemate.simulators.mujoco_world.frame_poses import Array, Pose, Vec, pose, vector_of
from linemate.simulators.mujoco_world.line import Profile
from linemate.simulators.mujoco_world.model import mjcf, mount_stiffness
from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell, RunOrder, known

GRAVITY = 9.81
Six = tuple[float, float, float, float, float, float]
C_IN_BASE = np.array(((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0)))
"""Nominal frame of the object: x down, y along the conveyor, z away from the robot."""

Place = tuple[Array, Array]
"""Position (3,) and rotation (3, 3) in base."""


class MujocoStation:
    """Model and state of one run.

    Attributes:
        stiffness: of the mount, along [N/m] and about [Nm/rad], (6,).
        rigid, tool, hub, wheel: numbers of the bodies.
        gripper, screws: numbers of the constraints that hold the wheel.
    """

    def __init__(self, cell: MujocoCell, order: RunOrder) -> None:
        """Compile the model of a station whose values are all drawn."""
        self._cell, self._order = cell, order
        self.model = model = mujoco.MjModel.from_xml_string(mjcf(cell, order))
        self.data = mujoco.MjData(model)
        self._reported = mujoco.MjData(model)
        self.stiffness = np.array(mount_stiffness(cell))
        axes = [model.joint(f"A{n}") for n in range(1, 7)]
        motors = [model.joint(f"M{n}") for n in range(6)]
        linear, unit = model.joint("E1"), model.joint("unit")
        mount = [model.joint(f"mount{n}") for n in range(6)]
        self._link_q = np.array([j.qposadr[0] for j in (*axes, linear)])
        self._link_v = np.array([j.dofadr[0] for j in (*axes, linear)])
        self._motor_q = np.array([j.qposadr[0] for j in (*motors, linear)])
        self._motor_v = np.array([j.dofadr[0] for j in (*motors, linear)])
        self._mount_q = np.array([j.qposadr[0] for j in mount])
        self._mount_v = np.array([j.dofadr[0] for j in mount])
        self._unit_q, self._unit_v = int(unit.qposadr[0]), int(unit.dofadr[0])
        self._wheel_q = int(model.joint("wheel").qposadr[0])
        self.rigid, self.tool = model.body("rigid").id, model.body("tool").id
        self._unit, self._body = model.body("unit").id, model.body("body").id
        self.hub, self.wheel = model.body("hub").id, model.body("wheel").id
        self.gripper = model.equality("gripper").id
        self.screws = model.equality("screws").id

    # Setting up

    def stand(self, line: Profile) -> None:
        """Put everything where it is at the beginning, in equilibrium."""
        model, data = self.model, self.data
        data.qpos[self._motor_q] = self._order.start
        data.qpos[self._link_q] = self._order.start
        data.qpos[self._unit_q], data.qvel[self._unit_v] = line.position[0], line.speed[0]
        self._swing()
        mujoco.mj_forward(model, data)
        # The mount's springs are at rest where they carry tool and wheel: the tcp was measured so.
        load = self.loads(is_gripped=True)
        model.qpos_spring[self._mount_q] = load[self._mount_v] / self.stiffness
        data.qpos[self._link_q[:6]] -= load[self._link_v[:6]] / np.array(self._cell.arm.stiffness)
        mujoco.mj_forward(model, data)
        here, quaternion = data.xpos[self.tool], data.xquat[self.tool]
        data.qpos[self._wheel_q : self._wheel_q + 7] = (*here, *quaternion)
        mujoco.mj_forward(model, data)
        mujoco.mj_step1(model, data)

    def _swing(self) -> None:
        """Let the body swing from before: each mode with its own phase."""
        car = self._cell.car
        draw = np.random.default_rng((self._order.seed, 0x5A6))
        lever = car.hanger - car.hub_in_centre[2]
        arms = {"fore_aft": lever, "lateral": lever, "yaw": abs(car.hub_in_centre[0])}
        for name, arm in arms.items():
            omega = math.tau * float(getattr(car, f"{name}_hz"))
            size = known(car.excitation) / omega**2 / arm
            phase = float(draw.uniform(0.0, math.tau))
            joint = self.model.joint(name)
            self.data.qpos[joint.qposadr[0]] = size * math.cos(phase)
            self.data.qvel[joint.dofadr[0]] = -size * omega * math.sin(phase)

    def moved_inertia(self) -> Array:
        """Return the inertia that each motor moves now, (7,) [kg m^2], E1 [kg]."""
        full = np.zeros((self.model.nv, self.model.nv))
        mujoco.mj_fullM(self.model, self.data, full)
        motors = np.array([*self._cell.arm.motor_inertia, 0.0])
        inertia: Array = np.diag(full)[self._link_v] + motors
        return inertia

    # Loads

    def loads(self, *, is_gripped: bool) -> Array:
        """Return what gravity and motion ask of each joint, (nv,).

        Args:
            is_gripped: the tool carries the wheel.
        """
        model, data = self.model, self.data
        load: Array = data.qfrc_bias - data.qfrc_gravcomp
        if is_gripped:
            tool, across = self._cell.tool, np.zeros((3, model.nv))
            place, turn = self.place(self.tool)
            centre = place + turn @ np.array(tool.wheel_centre)
            mujoco.mj_jac(model, data, across, None, centre, self.tool)
            load = load + across[2] * (known(tool.wheel_mass) * GRAVITY)
        return load

    def axis_loads(self, *, is_gripped: bool) -> Array:
        """Return the part of ``loads`` on A1..A6 and E1, (7,)."""
        load: Array = self.loads(is_gripped=is_gripped)[self._link_v]
        return load

    def wrench(self) -> Array:
        """Return force and torque of the mount's springs beyond those at the start, (6,)."""
        wrench: Array = self.stiffness * self.data.qpos[self._mount_q]
        return wrench

    def touch_n(self) -> float:
        """Return the force that the hub put on the wheel in the last time step [N].

        Screws that draw a wheel in press it against the hub: the two forces of this pair cancel
        and load neither the robot nor the body.
        """
        data = self.data
        total, force = np.zeros(3), np.zeros(6)
        for n in range(data.ncon):
            mujoco.mj_contactForce(self.model, data, n, force)
            contact = data.contact[n]
            # MuJoCo orders the two geometries by their kind: the force is that on the second.
            sign = 1.0 if self.model.geom_bodyid[contact.geom2] == self.wheel else -1.0
            total += sign * (contact.frame.reshape(3, 3).T @ force[:3])
        is_weld = data.efc_type == mujoco.mjtConstraint.mjCNSTR_EQUALITY
        screws = data.efc_force[is_weld & (data.efc_id == self.screws)]
        if len(screws):
            total -= screws[:3]
        return float(np.linalg.norm(total))

    def power(self) -> float:
        """Return the power of the mount's force on the car, relative to the conveyor [W]."""
        hub, unit = np.zeros(6), np.zeros(6)
        for body, speed in ((self.hub, hub), (self._unit, unit)):
            mujoco.mj_objectVelocity(
                self.model, self.data, mujoco.mjtObj.mjOBJ_XBODY, body, speed, 0
            )
        force = -self.place(self.rigid)[1] @ self.wrench()[:3]
        return float(force @ (hub[3:] - unit[3:]))

    # Motion

    def motors(self) -> tuple[Array, Array]:
        """Return positions and velocities of the motors, (7,) each [rad], E1 [m]."""
        return self.data.qpos[self._motor_q], self.data.qvel[self._motor_v]

    def unit(self) -> tuple[float, float]:
        """Return position [m] and speed [m/s] of the conveyor."""
        return float(self.data.qpos[self._unit_q]), float(self.data.qvel[self._unit_v])

    def drive(self, torques: Array, pull_n: float) -> None:
        """Go on by one time step.

        Args:
            torques: of the motors, (7,) [Nm], E1 [N].
            pull_n: force of the conveyor's drive [N].
        """
        self.data.qfrc_applied[self._motor_v] = torques
        self.data.qfrc_applied[self._unit_v] = pull_n
        mujoco.mj_step2(self.model, self.data)

    def settle(self) -> None:
        """Compute the poses of the instant that ``drive`` reached."""
        mujoco.mj_step1(self.model, self.data)

    def hold(self, *, by_gripper: bool, by_screws: bool) -> None:
        """Let the wheel be held by the gripper, by the screws, by both."""
        self.data.eq_active[self.gripper] = by_gripper
        self.data.eq_active[self.screws] = by_screws

    # Poses

    def place(self, body: int) -> Place:
        """Return where a body is in base."""
        return self.data.xpos[body], self.data.xmat[body].reshape(3, 3)

    def seen_from(self, frame: int, body: int) -> Place:
        """Return where a body is in the frame of another."""
        (here, turn), (there, turned) = self.place(frame), self.place(body)
        return turn.T @ (there - here), turn.T @ turned

    def position(self, frame: int, body: int) -> Vec:
        """Return the position of a body in the frame of another [m]."""
        (here, turn), (there, _) = self.place(frame), self.place(body)
        x, y, z = (turn.T @ (there - here)).tolist()
        return (x, y, z)

    def six(self, frame: int, body: int) -> Six:
        """Return where a body is in the frame of another: position [m], rotation vector [rad]."""
        position, rotation = self.seen_from(frame, body)
        x, y, z = position.tolist()
        return (x, y, z, *vector_of(rotation))

    def sway(self) -> Six:
        """Return how far the hanger has moved the hub: [m] and [rad] in the nominal frame c."""
        place, _ = self.place(self.hub)
        body_place, body_turn = self.place(self._body)
        # The body's frame is at its suspension, upright while it hangs still.
        moved = place - (body_place + body_turn.T @ (place - body_place))
        x, y, z = (C_IN_BASE.T @ moved).tolist()
        return (x, y, z, *vector_of(C_IN_BASE.T @ body_turn @ C_IN_BASE))

    def computed_tcp(self, axes: Array) -> Pose:
        """Return the rigid tcp of a stiff arm whose axes stand so, (7,)."""
        self._reported.qpos[self._link_q] = axes
        mujoco.mj_kinematics(self.model, self._reported)
        return pose(self._reported.xpos[self.rigid], self._reported.xmat[self.rigid])
