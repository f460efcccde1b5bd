"""Everything that enters a sampling step.

Law of this file: a step sees its ``Inputs`` and nothing else, so a recording of them replays
exactly. Empty means "no new sample"; ``robot`` is None in a step without a telegram.
"""

from enum import StrEnum

from msgspec import Struct

from linemate.protocol.samples import CameraSample, DistanceSample, RobotSample, WrenchSample


class MotionOrder(StrEnum):
    """What the operating state machine lets the step do."""

    HOLD = "hold"
    TRACK = "track"
    RETREAT = "retreat"


class Inputs(Struct, frozen=True):
    """What one sampling step is given.

    Attributes:
        k: number of the step; steps that were missed count too.
        stamp_ns: the time of telegram k on the monotonic clock [ns], measured or foreseen.
        robot: the newest state of the robot that arrived *before* telegram k, or None.
        distance: new samples, oldest first, bounded.
        camera: new samples, oldest first, bounded.
        wrench: new samples, oldest first, bounded.
        order: what the step may do.
        start: the edge on which the task begins.
        sent: the command of the step before reached the robot; one that got none holds.
        applied: where it holds then, A1..A6 [rad] and E1 [m], as far as the controller has told
            since; None: at the last command that was sent.
        pace: speed and acceleration of its setpoints there, if it does not hold but goes on from
            there: the steps since were made while a controller that was held up counted no
            cycles. None: it holds.
    """

    k: int
    stamp_ns: int
    robot: RobotSample | None
    distance: tuple[DistanceSample, ...] = ()
    camera: tuple[CameraSample, ...] = ()
    wrench: tuple[WrenchSample, ...] = ()
    order: MotionOrder = MotionOrder.HOLD
    start: bool = False
    sent: bool = True
    applied: tuple[float, ...] | None = None
    pace: tuple[tuple[float, ...], tuple[float, ...]] | None = None
