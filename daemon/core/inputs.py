"""Everything that enters a sampling step.

Invariants:
- A step reads its ``Inputs`` and nothing else, so that a recording replays exactly.
- An empty tuple means "no new sample"; ``robot`` is None in a step without a telegram.
"""

from enum import StrEnum

from msgspec import Struct

from linemate.protocol.stamped_samples import (
    CameraSample,
    DistanceSample,
    RobotSample,
    WrenchSample,
)


class MotionOrder(StrEnum):
    """What the operating state machine orders the step to do."""

    HOLD = "hold"
    TRACK = "track"
    RETREAT = "retreat"
    HOME = "home"
    FOLLOW = "follow"


class Inputs(Struct, frozen=True):
    """Inputs of one sampling step.

    Attributes:
        k: number of the step; missed steps count too.
        stamp_ns: time of telegram k on the monotonic clock [ns], measured or predicted.
        robot: the newest state of the robot that arrived *before* telegram k, or None.
        distance, camera, wrench: new samples, oldest first, bounded.
        order: what the step may do.
        start: the edge on which the task begins.
        sent: the command of the step before reached the robot; without one the robot holds.
        applied: where it holds then, A1..A6 [rad] and E1 [m], as last reported by the controller;
            None: at the last command that was sent.
        pace: speed and acceleration of its setpoints if it goes on from ``applied``: the steps
            since were made while a delayed controller counted no cycles. None: it holds.
        chunks: target poses handed in since the step before, oldest first, bounded; see
            ``followed_poses.Chunk``.
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
    chunks: tuple[tuple[tuple[float, ...], ...], ...] = ()
