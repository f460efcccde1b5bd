"""Multibody model of the station as MJCF, MuJoCo's own model format.

The arm's kinematics come from its URDF; masses, gears and the rest from ``cell``.

Invariants:
    Base frame: x towards the car, y along the conveyor, z up. SI units.
    Hub frame: z away from the robot, y along the conveyor, x down.
"""

import math
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

from linemate.simulators.mujoco_world.mujoco_cell import MujocoCell, RunOrder, Six, Three, known

URDF = Path(__file__).parents[2] / "daemon" / "data" / "arm.urdf"
"""The arm as its maker describes it: the same file that a site gives the daemon."""

TIMESTEP_S = 0.001

HUB_QUATERNION = (math.sqrt(0.5), 0.0, math.sqrt(0.5), 0.0)
TCP_IN_FLANGE = (-0.35, 0.0, 0.20)
TCP_QUATERNION = (math.sqrt(0.5), 0.0, -math.sqrt(0.5), 0.0)

CARRIAGE_KG = 1200.0
LINKS: tuple[tuple[float, Three, Three], ...] = (
    (350.0, (0.10, 0.0, -0.10), (25.0, 25.0, 20.0)),
    (230.0, (0.50, 0.0, 0.0), (5.0, 35.0, 35.0)),
    (160.0, (0.25, 0.0, -0.02), (5.0, 15.0, 15.0)),
    (60.0, (-0.35, 0.0, 0.0), (1.0, 5.0, 5.0)),
    (30.0, (0.03, 0.0, 0.0), (0.4, 0.6, 0.6)),
    (15.0, (0.12, 0.0, 0.0), (0.15, 0.15, 0.15)),
)
"""Links A1..A6: mass [kg], centre of gravity [m], inertia [kg m^2], in the link's frame."""

TOOL_INERTIA = (0.45, 0.45, 0.50)
WHEEL_INERTIA = (0.75, 0.75, 1.30)

BOLTS = 5
BOLT_CIRCLE_M = 0.056
BOLT_RADIUS_M = 0.007
BOLT_LENGTH_M = 0.018
HOLE_DEPTH_M = 0.008
EDGES = 8
EDGE_RADIUS_M = 0.002
PAD_RADIUS_M = 0.004
FACE_RADIUS_M = 0.075


@dataclass(frozen=True, slots=True)
class UrdfJoint:
    """A joint of the arm: place and axis in its parent link's frame."""

    name: str
    position: str
    rpy: str
    axis: str


def read_urdf() -> tuple[list[UrdfJoint], UrdfJoint]:
    """Return the joints of E1, A1..A6 in order, and the fixed joint of the flange."""
    joints = {}
    for element in ET.parse(URDF).getroot().iter("joint"):  # noqa: S314 - a file of our own
        origin, axis = element.find("origin"), element.find("axis")
        name = str(element.get("name"))
        joints[name] = UrdfJoint(
            name,
            "0 0 0" if origin is None else origin.get("xyz", "0 0 0"),
            "0 0 0" if origin is None else origin.get("rpy", "0 0 0"),
            "1 0 0" if axis is None else axis.get("xyz", "1 0 0"),
        )
    chain = [joints[name] for name in ("E1", *(f"A{n}" for n in range(1, 7)))]
    return chain, joints["flange_mount"]


def mjcf(cell: MujocoCell, order: RunOrder) -> str:
    """Return the model of a station whose values are all drawn.

    Args:
        order: of the run: where the hub is at conveyor reading 0.
    """
    return f"""<mujoco model="linemate station">
<compiler angle="radian" eulerseq="XYZ" autolimits="true"/>
<option timestep="{TIMESTEP_S}" integrator="implicitfast" cone="elliptic" impratio="5"
  iterations="30" tolerance="1e-10"/>
<size memory="4M"/>
<default><geom contype="0" conaffinity="0"/>
<joint damping="0" armature="0"/></default>
<worldbody>
{_conveyor(cell, order)}
{_arm(cell)}
{_motors(cell)}
{_wheel(cell)}
</worldbody>
<tendon>{_gears(cell)}</tendon>
<equality>
<weld name="gripper" body1="tool" body2="wheel" relpose="0 0 0 1 0 0 0"
  solref="0.004 1" solimp="0.99 0.999 0.0005"/>
<weld name="screws" body1="hub" body2="wheel" relpose="0 0 0 1 0 0 0" active="false"
  solref="0.02 1" solimp="0.95 0.99 0.001"/>
</equality>
<contact>{_pairs(cell)}</contact>
</mujoco>"""


def mode(inertia: float, hz: float, damping: float, pendulum: float = 0.0) -> tuple[float, float]:
    """Return spring [N/m or Nm/rad] and damper of a mode of that inertia.

    Args:
        pendulum: restoring stiffness that gravity has already.
    """
    omega = math.tau * hz
    return max(inertia * omega**2 - pendulum, 0.0), 2.0 * damping * inertia * omega


def _text(values: tuple[float, ...]) -> str:
    return " ".join(f"{value:.9g}" for value in values)


def _conveyor(cell: MujocoCell, order: RunOrder) -> str:
    """Return the moving carrier with the body hung from it."""
    car, line = cell.car, cell.line
    offset, tilt = known(car.offset), known(car.tilt)
    hub = tuple(h + o for h, o in zip(order.hub, offset, strict=True))
    towards, along, up = car.hub_in_centre
    pivot = (hub[0] - towards, hub[1] - along, hub[2] - up + car.hanger)
    lever = car.mass * car.hanger**2
    weight = car.mass * 9.81 * car.hanger
    pitch, roll, yaw = car.inertia
    modes = (
        ("fore_aft", "1 0 0", mode(pitch + lever, known(car.fore_aft_hz),
                                   known(car.fore_aft_damping), weight)),
        ("lateral", "0 1 0", mode(roll + lever, known(car.lateral_hz),
                                  known(car.lateral_damping), weight)),
        ("yaw", "0 0 1", mode(yaw, known(car.yaw_hz), known(car.yaw_damping))),
    )  # fmt: skip
    joints = "".join(
        f'<joint name="{name}" axis="{axis}" stiffness="{k:.9g}" damping="{c:.9g}"/>'
        for name, axis, (k, c) in modes
    )
    angle = known(line.askew)
    travel = (-math.sin(angle), math.cos(angle), 0.0)
    turned = _product(_quaternion(tilt), HUB_QUATERNION)
    return f"""<body name="unit" pos="{_text(pivot)}">
<inertial pos="0 0 0" mass="{line.moving_mass:.9g}" diaginertia="1e4 1e4 1e4"/>
<joint name="unit" type="slide" axis="{_text(travel)}"/>
<body name="body">{joints}
<inertial pos="0 0 {-car.hanger:.9g}" mass="{car.mass:.9g}" diaginertia="{_text(car.inertia)}"/>
<body name="hub" pos="{_text((towards, along, up - car.hanger))}" quat="{_text(turned)}">
<inertial pos="0 0 0" mass="1e-3" diaginertia="1e-6 1e-6 1e-6"/>
<geom name="face" type="cylinder" size="{FACE_RADIUS_M} 0.015" pos="0 0 0.015"/>
{_bolts(known(cell.tool.bolt_angle))}
</body></body></body>"""


def _bolts(angle: float) -> str:
    """Return the bolts on the hub; their tips point to the robot."""
    inner = -(BOLT_LENGTH_M - BOLT_RADIUS_M)
    return "".join(
        f'<geom name="bolt{n}" type="capsule" size="{BOLT_RADIUS_M}" '
        f'fromto="{x:.9g} {y:.9g} 0 {x:.9g} {y:.9g} {inner}"/>'
        for n, (x, y) in enumerate(_circle(angle))
    )


def _circle(angle: float) -> list[tuple[float, float]]:
    turns = [angle + math.tau * n / BOLTS for n in range(BOLTS)]
    return [(BOLT_CIRCLE_M * math.cos(turn), BOLT_CIRCLE_M * math.sin(turn)) for turn in turns]


def _arm(cell: MujocoCell) -> str:
    """Return linear axis, links, elastic mount and tool."""
    arm, tool = cell.arm, cell.tool
    chain, flange = read_urdf()
    friction = known(arm.friction_share)
    text = (
        f'<body name="carriage" pos="{chain[0].position}">'
        f'<inertial pos="0 0 0.3" mass="{CARRIAGE_KG}" diaginertia="100 100 100"/>'
        f'<joint name="E1" type="slide" axis="{chain[0].axis}" armature="300" '
        f'frictionloss="{arm.motor_friction[6] * friction:.9g}"/>'
    )
    for joint, (mass, centre, inertia), dry in zip(
        chain[1:], LINKS, arm.link_friction, strict=True
    ):
        text += (
            f'<body name="{joint.name}" pos="{joint.position}" euler="{joint.rpy}" '
            f'gravcomp="{arm.counterbalance}">'
            f'<inertial pos="{_text(centre)}" mass="{mass}" diaginertia="{_text(inertia)}"/>'
            f'<joint name="{joint.name}" axis="{joint.axis}" frictionloss="{dry * friction:.9g}"/>'
        )
    tool_mode = _mount(cell)
    return (
        f'{text}<body name="flange" pos="{flange.position}" euler="{flange.rpy}">'
        f'<body name="rigid" pos="{_text(TCP_IN_FLANGE)}" quat="{_text(TCP_QUATERNION)}">'
        f'<body name="tool">{tool_mode}<inertial pos="{_text(tool.tool_centre)}" '
        f'mass="{tool.tool_mass}" diaginertia="{_text(TOOL_INERTIA)}"/></body>'
        f"</body></body>{'</body>' * 7}"
    )


def mount_stiffness(cell: MujocoCell) -> Six:
    """Return the true stiffness of the mount: along [N/m] and about [Nm/rad]."""
    share = known(cell.tool.stiffness_share)
    a, b, c, d, e, f = (share * k for k in cell.tool.stiffness)
    return (a, b, c, d, e, f)


def _mount(cell: MujocoCell) -> str:
    tool = cell.tool
    mass = tool.tool_mass + known(tool.wheel_mass)
    moving = (mass, mass, mass, 1.4, 1.4, 1.8)
    axes = ("1 0 0", "0 1 0", "0 0 1") * 2
    text = ""
    for n, (k, inertia, axis) in enumerate(zip(mount_stiffness(cell), moving, axes, strict=True)):
        kind = "slide" if n < 3 else "hinge"
        damper = 2.0 * tool.damping * math.sqrt(k * inertia)
        text += (
            f'<joint name="mount{n}" type="{kind}" axis="{axis}" stiffness="{k:.9g}" '
            f'damping="{damper:.9g}"/>'
        )
    return text


def _motors(cell: MujocoCell) -> str:
    """Return the rotors of A1..A6, seen from the joint, each on an axis of its own."""
    arm = cell.arm
    friction = known(arm.friction_share)
    return "".join(
        f'<body name="motor{n}" pos="0 0 -1"><inertial pos="0 0 0" mass="1e-3" '
        f'diaginertia="1e-6 1e-6 1e-6"/><joint name="M{n}" axis="0 0 1" '
        f'armature="{arm.motor_inertia[n]}" frictionloss="{arm.motor_friction[n] * friction:.9g}"/>'
        f"</body>"
        for n in range(6)
    )


def _gears(cell: MujocoCell) -> str:
    """Return the gears: springs between a motor and its link."""
    arm = cell.arm
    text = ""
    for n, (k, inertia) in enumerate(zip(arm.stiffness, arm.motor_inertia, strict=True)):
        damper = 2.0 * arm.gear_damping * math.sqrt(k * inertia)
        text += (
            f'<fixed name="gear{n}" stiffness="{k:.9g}" damping="{damper:.9g}" springlength="0">'
            f'<joint joint="M{n}" coef="1"/><joint joint="A{n + 1}" coef="-1"/></fixed>'
        )
    return text


def _wheel(cell: MujocoCell) -> str:
    """Return the wheel with the edges of its holes and three pads on its mating face."""
    tool = cell.tool
    inner = BOLT_RADIUS_M + tool.hole_clearance + EDGE_RADIUS_M
    outer = inner + tool.chamfer
    geoms = ""
    for n, (x, y) in enumerate(_circle(0.0)):
        for e in range(EDGES):
            turn = math.tau * e / EDGES
            c, s = math.cos(turn), math.sin(turn)
            mouth = (x + outer * c, y + outer * s, -EDGE_RADIUS_M)
            root = (x + inner * c, y + inner * s, -HOLE_DEPTH_M)
            geoms += (
                f'<geom name="edge{n}_{e}" type="capsule" size="{EDGE_RADIUS_M}" '
                f'fromto="{_text(mouth)} {_text(root)}"/>'
            )
    for n in range(3):
        turn = math.tau * (n + 0.5) / 3
        place = (0.035 * math.cos(turn), 0.035 * math.sin(turn), -PAD_RADIUS_M)
        geoms += f'<geom name="pad{n}" type="sphere" size="{PAD_RADIUS_M}" pos="{_text(place)}"/>'
    return (
        f'<body name="wheel"><freejoint name="wheel"/><inertial pos="{_text(tool.wheel_centre)}" '
        f'mass="{known(tool.wheel_mass):.9g}" diaginertia="{_text(WHEEL_INERTIA)}"/>{geoms}</body>'
    )


def _pairs(cell: MujocoCell) -> str:
    """Return what may touch what: each bolt its hole, the pads the hub's face."""
    mu = known(cell.tool.friction)
    how = (
        f'condim="3" friction="{mu:.4g} {mu:.4g} 0 0 0" solref="0.004 1" solimp="0.95 0.99 0.0005"'
    )
    pairs = [(f"bolt{n}", f"edge{n}_{e}") for n in range(BOLTS) for e in range(EDGES)]
    pairs += [("face", f"pad{n}") for n in range(3)]
    return "".join(f'<pair geom1="{a}" geom2="{b}" {how}/>' for a, b in pairs)


def _quaternion(vector: Three) -> tuple[float, float, float, float]:
    angle = math.sqrt(sum(v * v for v in vector))
    share = 0.5 if angle < 1e-12 else math.sin(0.5 * angle) / angle
    x, y, z = vector
    return (math.cos(0.5 * angle), share * x, share * y, share * z)


def _product(
    a: tuple[float, float, float, float], b: tuple[float, float, float, float]
) -> tuple[float, float, float, float]:
    aw, ax, ay, az = a
    bw, bx, by, bz = b
    return (
        aw * bw - ax * bx - ay * by - az * bz,
        aw * bx + ax * bw + ay * bz - az * by,
        aw * by - ax * bz + ay * bw + az * bx,
        aw * bz + ax * by - ay * bx + az * bw,
    )
