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
from linemate.simulators.plants.rotation import Pose
from linemate.simulators.plants.scenario import DenavitHartenbergLink, Robot

_BARE: Pose = ((0.0, 0.0, 0.0), rotation.IDENTITY)

Values = tuple[float, ...]

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


def frames(
    links: tuple[DenavitHartenbergLink, ...], joints: Values
) -> tuple[list[Values], list[Values]]:
    """Compute where the axes are, in Craig's form.

    Args:
        joints: A1..A6 [rad]; more are ignored.

    Returns:
        Origins of the axes and of the flange in the arm's root [m], and the axes' directions.
    """
    place: Values = (0.0, 0.0, 0.0)
    x: Values = (1.0, 0.0, 0.0)
    y: Values = (0.0, 1.0, 0.0)
    z: Values = (0.0, 0.0, 1.0)
    origins, axes = [], []
    for n, link in enumerate(links):
        ca, sa = math.cos(link.alpha), math.sin(link.alpha)
        place = tuple(p + link.a * e for p, e in zip(place, x, strict=True))
        y, z = _turned(y, z, ca, sa)
        origins.append(place)
        axes.append(z)
        place = tuple(p + link.d * e for p, e in zip(place, z, strict=True))
        angle = joints[n] + link.theta
        x, y = _turned(x, y, math.cos(angle), math.sin(angle))
    return [*origins, place], axes


def _turned(a: Values, b: Values, c: float, s: float) -> tuple[Values, Values]:
    return (
        tuple(c * u + s * v for u, v in zip(a, b, strict=True)),
        tuple(c * v - s * u for u, v in zip(a, b, strict=True)),
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
