"""Forward kinematics of the arm on its linear axis (Denavit-Hartenberg, Craig's form).

The chain is straight code without multiplications by 0 or 1.

Invariants:
    The table is in the scenario; no model file is shared with the daemon.
    Poses in base; joints in KUKA's sense of rotation.
"""

import math
from collections.abc import Callable
from functools import lru_cache

from linemate.simulators.plants import rotation
from linemate.simulators.plants.rotation import Pose, Vec
from linemate.simulators.plants.scenario import DenavitHartenbergLink, Robot

_BARE: Pose = ((0.0, 0.0, 0.0), rotation.IDENTITY)

Values = tuple[float, ...]

LinkConstants = tuple[float, float, float, float, float]
"""Cosine and sine of alpha, a, d and theta of a link."""

Number = float | str
"""A constant, or the name or product that stands for a value."""


class ArmPlant:
    """Flange and tcp for joint angles and a position of the linear axis."""

    tcp: Callable[[tuple[float, ...]], Pose]
    """Rigid tcp in base, where the robot holds the tool without deflection, for A1..A6 [rad] and
    E1 [m] (root_in_base = Trans(0, E1, 0))."""

    def __init__(self, robot: Robot) -> None:
        self._links = robot.links
        self._root = (robot.root_position, rotation.exp(robot.root_rotation))
        tool = (robot.tcp_position, rotation.exp(robot.tcp_rotation))
        self.tcp = _compiled(self._links, tool, self._root)

    def flange(self, joints: tuple[float, ...]) -> Pose:
        """Flange in base.

        Args:
            joints: A1..A6 [rad], E1 [m].

        Returns:
            Pose of the flange in base.
        """
        return _compiled(self._links, _BARE, self._root)(joints)


@lru_cache(maxsize=16)
def _compiled(
    links: tuple[DenavitHartenbergLink, ...], tool: Pose, root: Pose
) -> Callable[[tuple[float, ...]], Pose]:
    """Make the function of the written out chain; many runs have one arm."""
    body = "\n    ".join(_chain(links, tool, root))
    space: dict[str, Callable[..., object]] = {"cos": math.cos, "sin": math.sin}
    exec(f"def tcp(joints, cos=cos, sin=sin):\n    {body}\n", space)  # noqa: S102 - our own text
    return space["tcp"]  # type: ignore[return-value]


def _chain(links: tuple[DenavitHartenbergLink, ...], tool: Pose, root: Pose) -> list[str]:
    """Write the chain out.

    Returns:
        Lines of a function of ``joints``.
    """
    lines = [f"{', '.join(f'q{n}' for n in range(len(links) + 1))} = joints"]
    (px, py, pz), turned = root
    place: list[Number] = [px, _sum(f"q{len(links)}", py), pz]
    x: list[Number] = list(turned[0::3])
    y: list[Number] = list(turned[1::3])
    z: list[Number] = list(turned[2::3])
    for n, link in enumerate(links):
        # Columns of the rotation: Rx(alpha) turns y and z, Tx(a) moves along x, and so on.
        ca, sa = _clean(math.cos(link.alpha)), _clean(math.sin(link.alpha))
        y, z = (
            _named(lines, f"u{n}", _mixed((ca, y), (sa, z))),
            _named(lines, f"w{n}", _mixed((ca, z), (-sa, y))),
        )
        place = _named(lines, f"p{n}", _mixed((1.0, place), (link.a, x), (link.d, z)))
        angle = f"q{n} + {link.theta!r}" if link.theta else f"q{n}"
        lines.append(f"a{n} = {angle}; c{n} = cos(a{n}); s{n} = sin(a{n}); m{n} = -s{n}")
        x, y = (
            _named(lines, f"x{n}", _mixed((f"c{n}", x), (f"s{n}", y))),
            _named(lines, f"y{n}", _mixed((f"c{n}", y), (f"m{n}", x))),
        )
    # The half turn about x from the last axis to the flange.
    y, z = _named(lines, "fy", _mixed((-1.0, y))), _named(lines, "fz", _mixed((-1.0, z)))
    (tx, ty, tz), r = tool
    place = _mixed((1.0, place), (tx, x), (ty, y), (tz, z))
    columns = [
        _mixed((_clean(r[i]), x), (_clean(r[3 + i]), y), (_clean(r[6 + i]), z)) for i in range(3)
    ]
    rows = ", ".join(str(value) for row in zip(*columns, strict=True) for value in row)
    return [*lines, f"return ({', '.join(map(str, place))}), ({rows})"]


def frames(links: tuple[LinkConstants, ...], joints: Values) -> tuple[list[Vec], list[Vec]]:
    """Compute where the axes are, in Craig's form.

    Args:
        links: cosine and sine of each link, as ``link_constants`` returns them.
        joints: A1..A6 [rad]; more are ignored.

    Returns:
        Origins of the axes and of the flange in the arm's root [m], and the axes' directions.
    """
    px = py = pz = 0.0
    x0, x1, x2 = 1.0, 0.0, 0.0
    y0, y1, y2 = 0.0, 1.0, 0.0
    z0, z1, z2 = 0.0, 0.0, 1.0
    origins: list[Vec] = []
    axes: list[Vec] = []
    for (ca, sa, a, d, theta), joint in zip(links, joints, strict=False):
        px, py, pz = px + a * x0, py + a * x1, pz + a * x2
        y0, z0 = ca * y0 + sa * z0, ca * z0 - sa * y0
        y1, z1 = ca * y1 + sa * z1, ca * z1 - sa * y1
        y2, z2 = ca * y2 + sa * z2, ca * z2 - sa * y2
        origins.append((px, py, pz))
        axes.append((z0, z1, z2))
        px, py, pz = px + d * z0, py + d * z1, pz + d * z2
        angle = joint + theta
        c, s = math.cos(angle), math.sin(angle)
        x0, y0 = c * x0 + s * y0, c * y0 - s * x0
        x1, y1 = c * x1 + s * y1, c * y1 - s * x1
        x2, y2 = c * x2 + s * y2, c * y2 - s * x2
    return [*origins, (px, py, pz)], axes


def link_constants(links: tuple[DenavitHartenbergLink, ...]) -> tuple[LinkConstants, ...]:
    """Return what ``frames`` needs of each link."""
    return tuple(
        (math.cos(link.alpha), math.sin(link.alpha), link.a, link.d, link.theta) for link in links
    )


def _named(lines: list[str], name: str, values: list[Number]) -> list[Number]:
    """Give what has to be computed names of its own, a line each."""
    numbers: list[Number] = []
    for axis, value in zip("xyz", values, strict=True):
        if isinstance(value, str) and not value.isidentifier():
            lines.append(f"{name}{axis} = {value}")
            numbers.append(f"{name}{axis}")
        else:
            numbers.append(value)
    return numbers


def _mixed(*parts: tuple[Number, list[Number]]) -> list[Number]:
    """A sum of multiples of vectors."""
    return [_sum(*(_times(factor, vector[i]) for factor, vector in parts)) for i in range(3)]


def _times(a: Number, b: Number) -> Number:
    """A product, without what is zero or one in it."""
    if isinstance(a, str) and isinstance(b, float):
        a, b = b, a
    if isinstance(a, str):
        return f"{a} * {b}"
    if isinstance(b, float):
        return a * b
    if a == 0.0:
        return 0.0
    if abs(a) == 1.0:
        return b if a > 0.0 else f"-{b}"
    return f"{a!r} * {b}"


def _sum(*terms: Number) -> Number:
    """A sum, without what is zero in it."""
    constant = sum(term for term in terms if isinstance(term, float))
    texts = [term for term in terms if isinstance(term, str)]
    if not texts:
        return constant
    return " + ".join([*texts, repr(constant)] if constant else texts)


def _clean(value: float) -> float:
    """A cosine or sine of a right angle without its rounding error."""
    return float(round(value)) if abs(value - round(value)) < 1e-15 else value
