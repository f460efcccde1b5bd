"""Sign of the force on a clamped tool: whether the force can measure where the object is.

A tool that presses is pushed back. A pull says that the object is farther away, and the target
advances. With a right sensor the pull falls then. With a sensor of the wrong sign it grows with
every advance, and the tool presses deeper into the object.

Invariants:
- A suspect force moves neither the estimate nor the target: the robot keeps what it has.
- A contact that was felt by a pull is suspect from its beginning.
- A pull that does not fall while the target advances is suspect.
- A push of a contact's force clears it.
"""

from msgspec import Struct

ADVANCE_M = 0.0002  # of the offset in one pull that has to show in the force [m]


class ForceSign(Struct, frozen=True):
    """What is known of the sign of the force in one contact.

    Attributes:
        is_suspect: the force does not measure the object.
        pull: force as the pull began [N]; None while the object does not pull.
        offset: along the tool's axis at that time [m].
    """

    is_suspect: bool = False
    pull: float | None = None
    offset: float = 0.0


TRUSTED = ForceSign()


def at_touch(force: float, least: float) -> ForceSign:
    """Return the state of a contact that begins.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
        least: force of a contact [N].
    """
    return ForceSign(is_suspect=force > least)


def advanced(sign: ForceSign, force: float, offset: float, least: float) -> ForceSign:
    """Return the state one step later.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
        offset: of the target by force, along the tool's axis [m].
        least: force of a contact [N].
    """
    if force < -least:
        return TRUSTED
    if sign.is_suspect:
        return sign
    if force <= least:
        return TRUSTED
    if sign.pull is None:
        return ForceSign(pull=force, offset=offset)
    grows = offset - sign.offset > ADVANCE_M and force >= sign.pull
    return ForceSign(is_suspect=grows, pull=sign.pull, offset=sign.offset)


def nearer(force: float) -> float:
    """Return a force at the touch by which the object is nearest [N].

    A pull places the object farther away than the tool. Only a push is proof of where it is.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
    """
    return -abs(force)
