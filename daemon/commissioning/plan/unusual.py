"""Settings that are possible and that few sites have: each costs force if it is wrong."""

import math
from collections.abc import Iterator

from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.core.control.settings import ControlSettings
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.task import TaskFile
from linemate.protocol.stamped_samples import AXES

LONGEST_DEAD_TIME = 0.15  # that a controller's interpolation and filters have together [s]
LARGEST_DAMPING = 1.5  # of a servo that `linemate identify` fits as one of second order
LATEST_DISTANCE = 0.02  # of a laser or an encoder: two of its own cycles at 100 Hz [s]
LARGEST_GAIN = 1.5  # of a sway: the free end of a rod that hangs
QUICKEST_CLAMP = 0.05  # a valve and a cylinder need that long [s]
WIDEST_CATCH = 0.01  # of bolts in holes, a centring or a clamp [m]
WIDEST_ANGLE = 0.1  # the same [rad]
HEAVIER = 2.0  # mass over that which a mode of the mount shows


def cautions(station: LoadedConfig) -> Iterator[str]:
    """Yield ``key: what is unusual, and what to check`` of a configuration and its task."""
    if station.config.learning is not None and station.config.production is not None:
        yield (
            "learning: production compiles each variant at start, so no servo model is learned; "
            "remove it, and identify the servos with `linemate identify`"
        )
    camera = station.config.camera
    if camera is not None and camera.frame is None:
        yield (
            "camera.frame: null takes a pose of any frame for one in the camera's own frame, which "
            "arm.camera_in_tcp places; name the frame that the camera sends"
        )
    yield from _of_servos(station.config.control)
    yield from _of_tracking(station.config.tracking)
    yield from _of_payload(station.config.control, station.config.tracking)
    yield from _of_tool(station.task.file)


def _of_servos(control: ControlSettings) -> Iterator[str]:
    identify = "`linemate identify` finds it"
    for n, servo in enumerate(control.servos):
        key = f"control.servos[{n}]"
        if servo.dead_time > LONGEST_DEAD_TIME:
            yield (
                f"{key}.dead_time: {servo.dead_time:g} s of {AXES[n]} is longer than "
                f"{LONGEST_DEAD_TIME:g} s; {identify}"
            )
        if servo.damping > LARGEST_DAMPING:
            yield (
                f"{key}.damping: {servo.damping:g} of {AXES[n]} is more than "
                f"{LARGEST_DAMPING:g}, which few drives have; {identify}"
            )


def _of_tracking(tracking: TrackingSettings) -> Iterator[str]:
    delay = tracking.distance.delay
    if delay > LATEST_DISTANCE:
        yield (
            f"tracking.distance.delay: {delay:g} s is longer than {LATEST_DISTANCE:g} s, and leads "
            "the tool ahead by the way of the line in it; check the sensor's data sheet"
        )
    gains = {f"tracking.swing[{n}].gain": mode.gain for n, mode in enumerate(tracking.swing)}
    for key, gain in {**gains, "tracking.sway.gain": tracking.sway.gain}.items():
        if gain > LARGEST_GAIN:
            yield (
                f"{key}: {gain:g} is more than a body that hangs has, {LARGEST_GAIN:g}; "
                "identify it from stops of the line"
            )


def _of_payload(control: ControlSettings, tracking: TrackingSettings) -> Iterator[str]:
    """Yield a mass that would swing far more slowly than the mount is stated to."""
    mass = tracking.payload.mass
    shown = min(
        stiffness / (2.0 * math.pi * mode.frequency_hz) ** 2
        for stiffness, mode in zip(tracking.tactile.stiffness, control.effector, strict=False)
    )
    if mass > HEAVIER * shown:
        yield (
            f"tracking.payload.mass: {mass:g} kg is more than twice the {shown:.0f} kg that "
            "tactile.stiffness and control.effector show; weigh the tool"
        )


def _of_tool(task: TaskFile) -> Iterator[str]:
    guard = task.guard
    for key, value, most, unit in (
        ("tolerance", guard.tolerance, WIDEST_CATCH, "m"),
        ("angle_tolerance", guard.angle_tolerance, WIDEST_ANGLE, "rad"),
    ):
        if value > most:
            yield (
                f"guard.{key}: {value:g} {unit} is more than a tool catches, {most:g} {unit}: the "
                "tool would touch next to the object; check the unit"
            )
    released = task.tool.released_after
    if released is not None and released < QUICKEST_CLAMP:
        yield (
            f"tool.released_after: {released:g} s is less than a clamp needs, "
            f"{QUICKEST_CLAMP:g} s, and the tool would leave a closed one; measure it"
        )
