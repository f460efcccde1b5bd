"""Limits of an arm's axes from its URDF.

Read from ``<limit lower upper velocity acceleration jerk>``. The last two are of URDF 1.2; most
files do not have them.

Invariants:
- A missing limit is refused with the joint's name, never guessed.
- Each axis has a direction and moves by itself.
"""

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace

from linemate.daemon.core.control.settings import AxisLimits, ControlSettings
from linemate.protocol.stamped_samples import AXES

ROUNDING = 1e-9  # a limit that is wider by less is not wider

# Plausible ranges by type of joint: beyond them the file is in degrees or mm.
_LARGEST_POSITION = {"revolute": (4.0 * math.pi, "rad"), "prismatic": (30.0, "m")}
_LARGEST_SPEED = {"revolute": 20.0, "prismatic": 5.0}  # [rad/s], [m/s]


class UrdfLimitsError(ValueError):
    """The URDF lacks a limit of an axis, or it is implausible; the message names it."""


def read(
    urdf: str, flange: str, *, linear_axis: bool, is_whole: bool = True
) -> tuple[AxisLimits, ...]:
    """Return the limits of A1..A6, then E1 where there is a linear axis.

    Args:
        flange: name of the flange's link.
        linear_axis: the first joint of the chain is E1.
        is_whole: acceleration and jerk are required; else a missing one is infinite.

    Raises:
        UrdfLimitsError: a limit is missing or implausible.
    """
    joints = _chain(urdf, flange)
    if linear_axis:
        joints = [*joints[1:], *joints[:1]]
    return tuple(_limits(joint, is_whole=is_whole) for joint in joints)


def completed(
    settings: ControlSettings, urdf: str, flange: str, *, linear_axis: bool
) -> ControlSettings:
    """Return settings with the URDF's limits, if they have none of their own.

    Raises:
        UrdfLimitsError: as ``read``.
    """
    if settings.limits:
        return settings
    return replace(settings, limits=read(urdf, flange, linear_axis=linear_axis))


def wider(
    settings: ControlSettings, urdf: str, flange: str, *, linear_axis: bool
) -> list[tuple[int, str, str]]:
    """Return which limits are wider than the URDF's, or empty.

    Returns:
        Number of the axis, name of the limit, what is wrong.

    Raises:
        UrdfLimitsError: a limit of the URDF is missing or implausible.
    """
    robot = read(urdf, flange, linear_axis=linear_axis, is_whole=not settings.limits)
    faults = []
    for axis, (own, largest) in enumerate(zip(settings.limits, robot, strict=False)):
        if own.lower >= own.upper:
            faults.append((axis, "lower", f"{own.lower:g} is not below upper: {own.upper:g}"))
        for name, is_beyond in (
            ("lower", own.lower < largest.lower - ROUNDING),
            ("upper", own.upper > largest.upper + ROUNDING),
            ("speed", own.speed > largest.speed + ROUNDING),
        ):
            if is_beyond:
                value, limit = getattr(own, name), getattr(largest, name)
                what = f"{value:g} is wider than the URDF's for {AXES[axis]}: {limit:g}"
                faults.append((axis, name, what))
    return faults


def _chain(urdf: str, flange: str) -> list[ET.Element]:
    """Return the joints that move, from the root to the flange."""
    try:
        root = ET.fromstring(urdf)  # noqa: S314 - a local file of the site's own
    except ET.ParseError as error:
        raise UrdfLimitsError(f"not XML: {error}") from error
    above: Mapping[str, ET.Element] = {
        child.get("link", ""): joint
        for joint in root.findall("joint")
        if (child := joint.find("child")) is not None
    }
    joints: list[ET.Element] = []
    link = flange
    while link in above and len(joints) <= len(above):
        joint = above[link]
        joints.append(joint)
        parent = joint.find("parent")
        link = "" if parent is None else parent.get("link", "")
    chain = [joint for joint in reversed(joints) if joint.get("type") in _LARGEST_POSITION]
    every = [joint for joint in root.findall("joint") if joint.get("type") in _LARGEST_POSITION]
    known = {"universe", *(element.get("name") for element in root)}  # kinematics refuses others
    if len(chain) < len(every) and flange in known:
        names = ", ".join(joint.get("name", "?") for joint in every if joint not in chain)
        raise UrdfLimitsError(
            f"{flange!r} is not moved by {names}. Name the link behind all axes in arm.flange, and "
            "fix the joints of a tool."
        )
    return chain


def _limits(joint: ET.Element, *, is_whole: bool) -> AxisLimits:
    name, kind = joint.get("name", "?"), joint.get("type", "")
    if joint.find("mimic") is not None:
        raise UrdfLimitsError(f"joint {name} mimics another one. Each axis moves by itself here.")
    axis = joint.find("axis")
    if axis is not None and not any(map(_nonzero, axis.get("xyz", "").split())):
        raise UrdfLimitsError(f"the <axis> of joint {name} has no direction")
    limit = joint.find("limit")
    if limit is None:
        raise UrdfLimitsError(f"joint {name} has no <limit>")
    lower, upper, speed = (_number(limit, name, key) for key in ("lower", "upper", "velocity"))
    acceleration, jerk = (
        _number(limit, name, key) if is_whole or key in limit.attrib else math.inf
        for key in ("acceleration", "jerk")
    )
    largest, unit = _LARGEST_POSITION[kind]
    for key, value in (("lower", lower), ("upper", upper)):
        if abs(value) > largest:
            raise UrdfLimitsError(
                f"joint {name}: {key} is {value:g}, at most {largest:.3g} {unit}. "
                f"Give it in {unit}."
            )
    if lower >= upper:
        raise UrdfLimitsError(f"joint {name}: lower is {lower:g}, not below upper: {upper:g}")
    if not 0.0 < speed <= _LARGEST_SPEED[kind]:
        raise UrdfLimitsError(
            f"joint {name}: velocity is {speed:g}, allowed are "
            f"0 to {_LARGEST_SPEED[kind]:g} {unit}/s"
        )
    if acceleration <= 0.0 or jerk <= 0.0:
        raise UrdfLimitsError(f"joint {name}: acceleration and jerk must be above 0")
    return AxisLimits(lower, upper, speed, acceleration, jerk)


def _nonzero(text: str) -> bool:
    try:
        return float(text) != 0.0
    except ValueError:
        return True  # pinocchio refuses it with its own words


def _number(limit: ET.Element, joint: str, key: str) -> float:
    text = limit.get(key)
    if text is None:
        raise UrdfLimitsError(
            f"the <limit> of joint {joint} has no {key}. Give control.limits for this arm, or add "
            f"{key} to the URDF."
        )
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise UrdfLimitsError(f"joint {joint}: {key} is {text[:32]!r}, not a finite number")
    return value
