"""Proof whether an object in contact gives way to the force of the tool.

An object that does not give way shows where it is by a deflection, and a target may follow it at
once. One that gives way would be driven by that. The tool presses on the object as it seats: one
that then lies still is firm. A force that swings to and fro later shows that it is not, as does a
body that is pushed. A stop or a start bends the mount to one side and back, which is no swing.

A calm force is a weak proof: a body that nothing excites is calm too. So it counts only while the
conveyor stands or starts, where a target that follows at once gains most: it follows the start.
Next to a running line a body of 300 kg at 3 Hz was driven to 1.1 mm and 119 N by it.

Invariants:
- An object is firm only after the tool has seated and the force has been calm for ``PROOF_S``.
- An object that has given way is not firm again in the same contact.
- Next to a conveyor that runs or stops no object is firm.
- A swing is quick as long as each of its half periods is shorter than the given time.
"""

from msgspec import Struct
from msgspec.structs import replace

from linemate.protocol.stamped_samples import Vector3

PROOF_S = 1.0  # for which a calm force proves an object firm [s]
SWING_N = 8.0  # to each side; the force is noisy by 1.4 N
TURNS = 4  # changes of side in a row: a bend to one side and back makes two
SWINGS = 2  # changes of side in a row of a swing; a late stop makes one while it bends the mount
LASTING_S = 1.0  # a swing has to the other side for so long: 0.5 Hz [s]


class Swing(Struct, frozen=True):
    """Force along one axis that swings to and fro.

    Attributes:
        side: of the last force beyond ``SWING_N``: 1 or -1, 0 before the first one.
        turns: changes of side in a row.
        age: since the last of them [s].
        quick_s: for which it has changed its side again and again within the given time [s].
    """

    side: int = 0
    turns: int = 0
    age: float = 0.0
    quick_s: float = 0.0


STILL = Swing()


class Firmness(Struct, frozen=True):
    """What is known of an object in contact.

    Attributes:
        is_firm: the object does not give way; None before that is known.
        calm_s: for how long the force has been calm since the tool seated [s].
        swings: of the force along x, y, z of c.
        has_swung: the force has changed its side ``SWINGS`` times in a row in this contact.
    """

    is_firm: bool | None = None
    calm_s: float = 0.0
    swings: tuple[Swing, Swing, Swing] = (STILL, STILL, STILL)
    has_swung: bool = False

    @property
    def quick_s(self) -> float:
        """For how long the force along an axis has swung quickly [s]."""
        x, y, z = self.swings
        return max(x.quick_s, y.quick_s, z.quick_s)


UNKNOWN = Firmness()


def advance(
    state: Firmness,
    swung: Vector3,
    dt: float,
    *,
    is_calm: bool,
    gives_way: bool,
    quick_s: float = 0.0,
) -> Firmness:
    """Return the state of a seated tool one step later.

    Args:
        swung: force off its mean, in c [N].
        quick_s: half a period of a swing that is quick [s].
        is_calm: no force oscillates more than is normal in contact.
        gives_way: the object was pushed, or an oscillation grows.
    """
    x, y, z = (
        _lasting(swing, turned(swing, f, dt), dt, quick_s)
        for swing, f in zip(state.swings, swung, strict=True)
    )
    turns = max(x.turns, y.turns, z.turns)
    has_swung = state.has_swung or turns >= SWINGS
    if state.is_firm is False or gives_way or turns >= TURNS:
        return Firmness(False, 0.0, (x, y, z), has_swung)
    calm_s = state.calm_s + dt if is_calm else 0.0
    is_firm = True if calm_s >= PROOF_S else state.is_firm
    return Firmness(is_firm, calm_s, (x, y, z), has_swung)


def without_proof(state: Firmness) -> Firmness:
    """Return the state of an object that is not proved firm any more; one that gave way stays."""
    if state.is_firm is False:
        return state
    return Firmness(None, 0.0, state.swings, state.has_swung)


def turned(swing: Swing, force: float, dt: float) -> Swing:
    """Return a swing one step later.

    Args:
        force: off its mean [N].
    """
    age = swing.age + dt
    if abs(force) < SWING_N:
        return STILL if age > LASTING_S else Swing(swing.side, swing.turns, age)
    side = 1 if force > 0.0 else -1
    if side == swing.side:
        return Swing(side, swing.turns, age)
    return Swing(side, swing.turns + 1 if swing.side else 0, 0.0)


def _lasting(before: Swing, swing: Swing, dt: float, quick_s: float) -> Swing:
    """Return a swing with the time for which it has been quick."""
    has_turned = swing.turns > before.turns
    is_quick = swing.side != 0 and (before.age if has_turned else swing.age) < quick_s
    if not is_quick and swing.quick_s == 0.0:
        return swing
    return replace(swing, quick_s=before.quick_s + dt if is_quick else 0.0)
