"""Sign of the force on a clamped tool: whether the force can measure where the object is.

A tool that presses is pushed back. A pull says that the object is farther away, and the target
advances. With a right sensor the pull falls then. With a sensor of the wrong sign it grows with
every advance, and the tool presses deeper into the object.

Invariants:
- A suspect force moves neither the estimate nor, but for its test, the target.
- A contact that was felt by a pull is suspect from its beginning, unless the sensor has shown the
  weight of the free tool: then its sign is right, and the object pulls.
- A pull that does not fall while the target advances is suspect. If the sensor has shown the weight
  of the free tool, a body may sway away first: its pull falls within half a period of the sway.
- A push of a contact's force clears it.
- A suspect force is tested: the target advances slowly, and a right force falls. Then it is
  cleared. If the force grows, or does not answer, the target goes back.
- A large force that has answered none of its tests ends the contact: nothing would unload it.
"""

from msgspec import Struct
from msgspec.structs import replace

ADVANCE_M = 0.0002  # of the offset in one pull that has to show in the force [m]
SEATED_S = 0.3  # the clamp has closed, and the tool has seated by then [s]
TEST_SPEED = 0.002  # of the target in a test: quicker than a line that is askew [m/s]
TEST_N = 20.0  # change of the mean force that ends a test [N]
MEAN_S = 0.5  # time constant of that mean: a body in contact sways at 0.5 Hz or more [s]
LONGEST_M = 0.006  # way of a test: a body on a soft carrier gives way to most of it [m]
REST_S = 1.0  # before each test [s]
TESTS = 4  # that may fail
UNANSWERED = 0.25  # share of the overload, as a mean, that a contact may have after them


class ForceSign(Struct, frozen=True):
    """What is known of the sign of the force in one contact.

    Attributes:
        is_suspect: the force does not measure the object.
        pull: force as the pull or its test began [N]; None while the object does not pull. The
            largest one if the sensor has shown the weight of the free tool.
        offset: along the tool's axis as the pull or its test began [m].
        advanced_s: time since the target has advanced in the pull [s].
        way: by which the target has advanced in a test of a suspect force [m].
        is_failed: the force did not answer: the target goes back.
        mean: force of a suspect contact [N].
        rest: for how long it has been averaged before the test [s].
        failed: number of tests that failed.
    """

    is_suspect: bool = False
    pull: float | None = None
    offset: float = 0.0
    advanced_s: float = 0.0
    way: float = 0.0
    is_failed: bool = False
    mean: float = 0.0
    rest: float = 0.0
    failed: int = 0


TRUSTED = ForceSign()


def at_touch(force: float, least: float, *, shows_weight: bool = False) -> ForceSign:
    """Return the state of a contact that begins.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
        least: force of a contact [N].
        shows_weight: the sensor showed the weight of the free tool.
    """
    return ForceSign(is_suspect=force > least and not shows_weight)


def advanced(
    sign: ForceSign, force: float, offset: float | None, least: float, right_dt: float | None = None
) -> ForceSign:
    """Return the state one step later.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
        offset: of the target by force, along the tool's axis [m]; None before it has begun.
        least: force of a contact [N].
        right_dt: length of the step, of a sensor that has shown the weight of the free tool [s].
    """
    if force < -least:
        return TRUSTED
    if sign.is_suspect or offset is None:
        return sign
    if force <= least:
        return TRUSTED
    if sign.pull is None:
        return ForceSign(pull=force, offset=offset)
    has_advanced, does_not_fall = offset - sign.offset > ADVANCE_M, force >= sign.pull
    if right_dt is None:
        return ForceSign(has_advanced and does_not_fall, sign.pull, sign.offset)
    since = sign.advanced_s + right_dt if has_advanced else 0.0
    pull = max(force, sign.pull)
    return ForceSign(does_not_fall and since > MEAN_S, pull, sign.offset, since)


def tested(sign: ForceSign, force: float, dt: float) -> ForceSign:
    """Return the state of a suspect force one step later, with its test.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
        dt: length of the step [s].
    """
    rest = sign.rest + dt
    mean = sign.mean + dt / min(rest, MEAN_S) * (force - sign.mean)
    sign = replace(sign, mean=mean, rest=rest)
    if sign.is_failed:
        way = max(sign.way - TEST_SPEED * dt, 0.0)
        return replace(sign, way=way, is_failed=way > 0.0, rest=0.0)
    if rest < REST_S or sign.failed >= TESTS:
        return replace(sign, pull=mean)
    before, way = sign.pull or 0.0, sign.way + TEST_SPEED * dt
    if mean < before - TEST_N:
        return TRUSTED
    if mean > before + TEST_N or way > LONGEST_M:
        return replace(sign, is_failed=True, failed=sign.failed + 1)
    return replace(sign, way=way)


def unanswered(sign: ForceSign, mean: float, overload: float) -> float | None:
    """Return the mean force of a contact that answers no test [N], or None.

    Args:
        mean: size of the mean force on the tool [N].
        overload: force that the tool withstands [N].
    """
    is_over = sign.is_suspect and sign.failed >= TESTS and not sign.is_failed
    return mean if is_over and mean > UNANSWERED * overload else None


def nearer(force: float) -> float:
    """Return a force at the touch by which the object is nearest [N].

    A pull places the object farther away than the tool. Only a push is proof of where it is.

    Args:
        force: along the tool's axis, less than 0 if it pushes the tool back [N].
    """
    return -abs(force)
