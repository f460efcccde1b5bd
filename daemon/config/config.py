"""Configuration of a daemon: its file and every file that it names, checked together.

Invariants:
- One call reports every error of every file, as ``file:line:col: key: what``.
- No port is opened and no file is written.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from linemate.daemon.config import documents, overlays, task_file
from linemate.daemon.config.controller_section import ControllerFile, default_port
from linemate.daemon.config.documents import FileError, YamlDocument
from linemate.daemon.config.named_files import NamedFiles
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.settings import (
    Config,
    ControllerKind,
    EgmSettings,
    FanucSettings,
    RsiSettings,
    window_error,
)
from linemate.daemon.config.settings_tree import Settings
from linemate.daemon.config.task_file import Task
from linemate.daemon.core import rotations
from linemate.daemon.core.control import urdf_limits
from linemate.daemon.core.tracking.settings import TrackingSettings
from linemate.daemon.core.tracking.touch.tare import GRAVITY, LARGEST_SAG
from linemate.protocol.command.preshared_keys import PresharedKey
from linemate.protocol.sensors.distance import DistanceDecoder
from linemate.protocol.sensors.wrench import LARGEST_FORCES

LEAST_RADIUS = 0.05  # of the mount's springs about the tool's axis [m]
LARGEST_SENSOR_REACH = 0.5  # from the flange to a sensor that is farther than the tcp [m]


@dataclass(frozen=True, slots=True)
class RobotEndpoint:
    """Socket of the robot's telegrams.

    Attributes:
        port: local UDP port, 0 for any.
        peer: the only address that is answered. None: any address.
    """

    bind: str
    port: int
    peer: str | None = None


@dataclass(frozen=True, slots=True)
class LoadedConfig:
    """Everything from files that a daemon is started with.

    Attributes:
        path: path of the configuration file.
        controller_file: the controller's own configuration, None for a family without one.
        dbc: text of the distance sensor's DBC, None without that sensor.
        keys: pre-shared keys of the command port.
        texts: files for recordings, by name: config, task, urdf, geometry, dbc, and the
            controller's family.
        written: the parameters without what operators saved.
        state: directory for what operators save, None if there is none.
        variants: tasks of the production's variants, by name.
        count_m: count of the distance sensor, 0 without one [m].
    """

    path: Path
    config: Config
    task: Task
    controller_file: ControllerFile | None
    dbc: str | None
    keys: tuple[PresharedKey, ...]
    texts: dict[str, str] = field(repr=False)
    written: Settings
    state: Path | None = None
    variants: dict[str, Task] = field(default_factory=dict, repr=False)
    count_m: float = 0.0

    @property
    def cycle_s(self) -> float:
        """Period of the controller [s]."""
        return self._link.cycle_ms * 1e-3

    @property
    def robot(self) -> "RobotEndpoint":
        """Where the robot's telegrams arrive."""
        link = self._link
        port = link.port
        if port is None:
            port = default_port(self.config.controller.kind, self.controller_file) or 0
        return RobotEndpoint(link.bind, port, link.peer)

    @property
    def _link(self) -> RsiSettings | EgmSettings | FanucSettings:
        """Section of the controller's family."""
        config = self.config
        sections: dict[ControllerKind, RsiSettings | EgmSettings | FanucSettings] = {
            ControllerKind.RSI: config.rsi,
            ControllerKind.EGM: config.egm,
            ControllerKind.FANUC: config.fanuc,
        }
        return sections[config.controller.kind]


def load(path: Path, extra_overlays: Sequence[Path] = (), *, saved: bool = True) -> LoadedConfig:
    """Load a configuration file and everything that it names.

    Args:
        extra_overlays: laid over those that it names, as if it named them last.
        saved: include what operators saved.

    Raises:
        FileError: every error at once.
    """
    data = documents.content(path)
    document = documents.read(data, str(path))
    named = NamedFiles(path.parent, document.value)
    try:
        config = documents.fill(document, Config, named.complaints)
    except FileError as error:
        raise FileError([*error.lines, *named.lines]) from error
    lacks_file = config.controller.kind is ControllerKind.RSI and named.controller is None
    if named.lines or named.task is None or lacks_file:
        raise FileError(named.lines)
    _refuse_disordered_window(document, config)
    texts = {"config": data.decode("utf-8-sig"), **named.texts}
    base = path.parent
    if extra_overlays:
        extra = tuple(str(each.absolute()) for each in extra_overlays)
        config = replace(config, overlays=(*config.overlays, *extra))
    written = overlays.apply(document, config, base, saved=False)
    task = overlays.apply_to_task(named.task, config, base)
    variants = {
        name: overlays.apply_to_task(variant, config, base, is_variant=True)
        for name, variant in named.variants.items()
    }
    texts["task"] = task.text
    config = _with_urdf_limits(overlays.apply(document, config, base, saved=saved), task)
    texts |= task_file.geometry_text(config.control.geometry)
    _refuse_wider_limits(document, config, task)
    count_m = _count(config, named.dbc)
    unbearable = [*device_complaints(config, config.tracking, count_m)]
    if unbearable:
        raise FileError(document.lines(unbearable))
    _refuse_far_sensor(config, task)
    return LoadedConfig(
        path,
        config,
        task,
        named.controller,
        named.dbc,
        named.keys,
        texts,
        overlays.settings_of(_with_urdf_limits(written, task)),
        overlays.directory(config, base),
        variants,
        count_m,
    )


def _with_urdf_limits(config: Config, task: Task) -> Config:
    """Return a configuration with the URDF's limits where it has none of its own.

    Raises:
        FileError: the URDF lacks some of them.
    """
    arm = task.file.arm
    try:
        control = urdf_limits.completed(
            config.control, task.urdf, arm.flange, linear_axis=arm.linear_axis
        )
    except urdf_limits.UrdfLimitsError as error:
        raise FileError([f"{arm.urdf}:1:1: (file): {error}"]) from error
    return replace(config, control=control)


def _refuse_disordered_window(document: YamlDocument, config: Config) -> None:
    """Refuse a tracking window whose positions are out of order.

    Raises:
        FileError: the first of them.
    """
    production = config.production
    if production is None:
        return
    error = window_error(production.window, production.announced_at)
    if error is not None:
        path = ("production", *error[0].split("."))
        raise FileError(document.lines([Complaint(path, error[1])]))


def _refuse_wider_limits(document: YamlDocument, config: Config, task: Task) -> None:
    """Refuse limits beyond the URDF's.

    Raises:
        FileError: each of them.
    """
    arm = task.file.arm
    try:
        wider = urdf_limits.wider(
            config.control, task.urdf, arm.flange, linear_axis=arm.linear_axis
        )
    except urdf_limits.UrdfLimitsError as error:
        raise FileError([f"{arm.urdf}:1:1: (file): {error}"]) from error
    if wider:
        complaints = [
            Complaint(("control", "limits", axis, name), what) for axis, name, what in wider
        ]
        raise FileError(document.lines(complaints))


def device_complaints(
    config: Config, tracking: TrackingSettings, count_m: float
) -> Iterator[Complaint]:
    """Yield what the elastic mount, its force-torque sensor or the distance sensor cannot have.

    Args:
        config: with the force-torque sensor's device.
        tracking: the settings to check.
        count_m: count of the distance sensor, 0 without one [m].
    """
    payload, tactile = tracking.payload, tracking.tactile
    overload, stiffness = tactile.overload_force, max(tactile.stiffness)
    for section, name, value, force in (
        ("payload", "mass", f"{payload.mass:g} kg", payload.mass * GRAVITY),
        ("payload", "part_mass", f"{payload.part_mass:g} kg", payload.part_mass * GRAVITY),
        ("tactile", "overload_force", f"{overload:g} N", overload),
    ):
        if force > LARGEST_SAG * stiffness:
            what = (
                f"{value} bend the mount by {1e3 * force / stiffness:.0f} mm at {stiffness:g} N/m, "
                f"{1e3 * LARGEST_SAG:g} mm at most. Check it, and tracking.tactile.stiffness."
            )
            yield Complaint(("tracking", section, name), what)
    lever = math.hypot(*payload.centre)
    turn = payload.mass * GRAVITY * lever / max(tactile.rotational_stiffness)
    if turn > LARGEST_SAG:
        what = (
            f"{payload.mass:g} kg turn the mount by {1e3 * turn:.0f} mrad {lever:g} m from the "
            f"tcp, {1e3 * LARGEST_SAG:g} mrad at most. Check the unit."
        )
        yield Complaint(("tracking", "payload", "centre"), what)
    # The touch speed leaves half the overload to what follows until the tool reacts to a touch.
    if tactile.contact_force > 0.5 * overload:
        what = (
            f"a touch is felt from {tactile.contact_force:g} N on, at most half the overload of "
            f"{overload:g} N: the tool needs the other half to react. Set a smaller one."
        )
        yield Complaint(("tracking", "tactile", "contact_force"), what)
    radius = math.sqrt(min(tactile.rotational_stiffness) / stiffness)
    if radius < LEAST_RADIUS:
        what = (
            f"{min(tactile.rotational_stiffness):g} Nm/rad at {stiffness:g} N/m are springs "
            f"{1e3 * radius:.0f} mm from the axis, at least {1e3 * LEAST_RADIUS:g} mm. Check the "
            "unit: it is not Nm per degree."
        )
        yield Complaint(("tracking", "tactile", "rotational_stiffness"), what)
    if config.force_torque is not None:
        yield from _unseen_overload(config.force_torque.device, tracking)
    yield from _count_complaints(tracking.distance.deviation, count_m)


def _unseen_overload(device: str, tracking: TrackingSettings) -> Iterator[Complaint]:
    """Yield an overload that the force-torque sensor cannot state next to the tool's weight."""
    largest, weight = LARGEST_FORCES[device], tracking.payload.mass * GRAVITY
    overload = tracking.tactile.overload_force
    if overload + weight >= largest:
        what = (
            f"{overload:g} N and the tool's {weight:.0f} N are beyond what an axis of {device} "
            f"can state, {largest:.0f} N: no overload would be seen. Set a smaller one."
        )
        yield Complaint(("tracking", "tactile", "overload_force"), what)


def _count(config: Config, dbc: str | None) -> float:
    """Return the count of the distance sensor, 0 without one [m]."""
    distance = config.distance
    if distance is None or dbc is None:
        return 0.0
    return DistanceDecoder(dbc, distance.message, distance.signal, step=distance.step_m).step_m


def _count_complaints(deviation: float, count_m: float) -> Iterator[Complaint]:
    """Yield a complaint about a deviation of the distance below that of its rounded counts."""
    least = count_m / math.sqrt(12.0)  # of a reading that is rounded to counts
    if deviation < least:
        what = (
            f"{1e3 * deviation:g} mm is less than counts of {1e3 * count_m:g} mm have, "
            f"{1e3 * least:.2g} mm. Set what `linemate identify` measures, or that."
        )
        yield Complaint(("tracking", "distance", "deviation"), what)


def _refuse_far_sensor(config: Config, task: Task) -> None:
    """Refuse a force-torque sensor beyond the tool: its lever would make a torque of each force.

    Raises:
        FileError: it is farther from the flange than the tcp, and than any tool.
    """
    arm = task.file.arm
    tool, sensor = arm.tcp_in_flange, arm.sensor_in_tcp.position
    turned = rotations.matrix(tool.quaternion) @ np.array(sensor)
    far = math.dist(tool.position, -turned)
    most = max(math.hypot(*tool.position), LARGEST_SENSOR_REACH)
    if config.force_torque is not None and far > most:
        what = (
            f"the sensor would be {far:.2f} m from the flange, at most {most:g} m. Check the "
            "unit and the sign: its place is seen from the tcp."
        )
        raise FileError(task.lines([Complaint(("arm", "sensor_in_tcp", "position"), what)]))


def schema() -> dict[str, Any]:
    """Return the JSON schema of configuration files, with the meaning of each key."""
    return documents.schema(Config, "linemate configuration")
