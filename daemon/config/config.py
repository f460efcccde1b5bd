"""The configuration file with everything that it names, checked before anything is opened.

Law of this file: one reading tells every error of every file, as ``file:line:col: key: what``;
what passes here can be started without another surprise from a file. Nothing is bound, opened
for writing or changed.
"""

import grp
import ipaddress
import os
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

from linemate.daemon.config import (
    documents,
    files,
    overlay,
    parameter_list,
    rsi_check,
    task_file,
    timeouts,
)
from linemate.daemon.config.documents import Complaint, Document, FileError
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.key_file import key_path, read_keys
from linemate.daemon.config.settings import Config, Corrections
from linemate.daemon.config.settings_tree import Settings
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.control import urdf_limits
from linemate.drivers.camera_peer import parse_peer
from linemate.protocol.command.preshared_keys import PresharedKey
from linemate.protocol.rsi.codec import RsiCodec
from linemate.protocol.rsi.ethernet_config import RsiConfig, parse_config
from linemate.protocol.rsi.xml_scan import RsiError
from linemate.protocol.sensors.distance import DistanceDecoder, DistanceError, message_names

T = TypeVar("T")

MAX_LINK_BYTES = 1_048_576

_CORRECTION = {"A": "AK", "E": "EK"}
_ADDRESSES = (
    ("rsi", "bind"),
    ("rsi", "peer"),
    ("camera", "bind"),
    ("command", "udp", "bind"),
)
_DIRECTORIES = (("recording", "directory"), ("realtime", "incidents"))


@dataclass(frozen=True, slots=True)
class Station:
    """All that a daemon is started with.

    Attributes:
        path: of the configuration file.
        task: the task and the arm.
        rsi: the controller's own configuration.
        dbc: the distance sensor's, None without one.
        keys: pre-shared keys of the command port.
        texts: the files by role, for recordings: config, task, urdf, rsi, dbc.
        written: the parameters as the user wrote them, without what operators saved.
        state: directory for what operators save, None if there is none.
    """

    path: Path
    config: Config
    task: Task
    rsi: RsiConfig
    dbc: str | None
    keys: tuple[PresharedKey, ...]
    texts: dict[str, str] = field(repr=False)
    written: Settings
    state: Path | None = None

    @property
    def rsi_port(self) -> int:
        """The port telegrams come to."""
        port = self.config.rsi.port
        return self.rsi.port if port is None else port


def load(path: Path) -> Station:
    """Load a configuration file and everything that it names.

    Raises:
        FileError: every error at once.
    """
    try:
        data = files.read(path, documents.MAX_BYTES)
    except UnreadableError as error:
        raise FileError([f"{path}:1:1: (file): {error}"]) from error
    document = documents.read(data, str(path))
    named = _Named(path.parent, document.value)
    try:
        config = documents.fill(document, Config, named.complaints)
    except FileError as error:
        raise FileError([*error.lines, *named.elsewhere]) from error
    if named.elsewhere or named.task is None or named.rsi is None:
        raise FileError(named.elsewhere)
    texts = {"config": data.decode("utf-8-sig"), **named.texts}
    written = _with_limits(overlay.laid(document, config, path.parent, saved=False), named.task)
    config = _with_limits(overlay.laid(document, config, path.parent), named.task)
    _refuse_wider(document, config, named.task)
    return Station(
        path,
        config,
        named.task,
        named.rsi,
        named.dbc,
        named.keys,
        texts,
        overlay.settings_of(written),
        overlay.directory(config, path.parent),
    )


def _with_limits(config: Config, task: Task) -> Config:
    """Return a configuration with the URDF's limits, if it has none of its own.

    Raises:
        FileError: the URDF does not say all of them.
    """
    arm = task.file.arm
    try:
        control = urdf_limits.completed(
            config.control, task.urdf, arm.flange, linear_axis=arm.linear_axis
        )
    except urdf_limits.UrdfLimitsError as error:
        raise FileError([f"{arm.urdf}:1:1: (file): {error}"]) from error
    return replace(config, control=control)


def _refuse_wider(document: Document, config: Config, task: Task) -> None:
    """Refuse limits beyond the URDF's.

    Raises:
        FileError: each of them.
    """
    arm = task.file.arm
    try:
        found = urdf_limits.wider(
            config.control, task.urdf, arm.flange, linear_axis=arm.linear_axis
        )
    except urdf_limits.UrdfLimitsError as error:
        raise FileError([f"{arm.urdf}:1:1: (file): {error}"]) from error
    if found:
        told = (Complaint(("control", "limits", axis, name), what) for axis, name, what in found)
        raise FileError(document.lines(told))


def schema() -> dict[str, Any]:
    """The JSON schema of configuration files, each key with its meaning."""
    whole = documents.schema(Config, "linemate configuration")
    _explain(whole, Config)
    for kind in {kind.__name__: kind for kind in parameter_list.kinds(Config)}.values():
        if kind.__name__ in whole["$defs"]:
            _explain(whole["$defs"][kind.__name__], kind)
    return whole


def _explain(definition: dict[str, Any], kind: type[Any]) -> None:
    """Put a class's meanings to its keys, where an editor shows them."""
    definition["description"] = (kind.__doc__ or "").partition("\n")[0]
    meanings = parameter_list.about(kind)
    for name, described in definition["properties"].items():
        if "describe" in meanings[name]:  # a section is told by its own class
            described["description"] = meanings[name]["describe"]


class _Named:
    """The files that a configuration names, and what is wrong with them.

    Works on plain values, so that their errors come together with the file's own.
    """

    def __init__(self, base: Path, value: Any) -> None:
        self.task: Task | None = None
        self.rsi: RsiConfig | None = None
        self.dbc: str | None = None
        self.keys: tuple[PresharedKey, ...] = ()
        self.texts: dict[str, str] = {}
        self.elsewhere: list[str] = []
        self._decoder: tuple[str, str, str] | None = None
        self._base = base
        self._value = value

    def complaints(self, _: Any) -> Iterator[Complaint]:
        """Read all files; what is wrong in the task file goes to ``elsewhere``."""
        yield from self._attempt(("task",), self._read_task)
        yield from self._attempt(("rsi", "config"), self._read_rsi)
        yield from self._attempt(("rsi", "config"), self._look_at_axes)
        yield from self._rsi_complaints()
        yield from self._attempt(("rsi", "linear_axes"), self._look_at_linear_axes)
        yield from self._attempt(("distance", "dbc"), self._read_dbc)
        yield from self._attempt(("distance", "message"), self._look_at_message)
        yield from self._attempt(("distance", "strength"), self._look_at_strength)
        yield from self._attempt(("command", "udp", "keys"), self._read_keys)
        for directory in _DIRECTORIES:
            yield from self._attempt(directory, partial(self._look_at_directory, directory))
        yield from self._attempt(("state",), self._look_at_state)
        yield from self._attempt(("command", "socket"), self._look_at_socket)
        for groups in ("operate_groups", "view_groups"):
            yield from self._attempt(("command", groups), partial(self._look_at_groups, groups))
        yield from self._attempt(("distance", "can"), self._look_at_can)
        for path in _ADDRESSES:
            yield from self._attempt(path, partial(self._look_at_address, path))
        yield from self._attempt(("camera", "peer"), self._look_at_camera_peer)
        yield from self._attempt(("command", "udp", "bind"), self._look_at_consent)
        yield from self._shared_ports()
        yield from timeouts.complaints(self._value)

    def _attempt(self, path: tuple[str, ...], read: Callable[[], None]) -> Iterator[Complaint]:
        try:
            read()
        except FileError as error:
            self.elsewhere.extend(error.lines)
        except (UnreadableError, RsiError, DistanceError, ValueError) as error:
            for what in str(error).splitlines():  # a bad key file has one for each bad line
                yield Complaint(path, what)

    def _get(self, *path: str, kind: type[T], default: T | None = None) -> T | None:
        """A value of the right kind, the default where it is not given, else None."""
        value = self._value
        for part in path:
            if not isinstance(value, dict):
                return None
            if part not in value:
                return default
            value = value[part]
        return value if isinstance(value, kind) else None

    def _has(self, section: str) -> bool:
        return self._get(section, kind=dict) is not None

    def _read_task(self) -> None:
        name = self._get("task", kind=str)
        if name:
            path = files.find(name, self._base, files.DAEMON_DATA)
            self.task = task_file.load(path)
            self.texts |= {"task": self.task.text, "urdf": self.task.urdf}

    def _read_rsi(self) -> None:
        name = self._get("rsi", "config", kind=str, default="rsi_joints.xml")
        if not self._has("rsi"):
            name = "rsi_joints.xml"
        if name:
            path = files.find(name, self._base, files.PROTOCOL_DATA)
            data = files.read(path, MAX_LINK_BYTES)
            self.rsi = parse_config(data)
            RsiCodec(self.rsi)
            self.texts["rsi"] = data.decode("utf-8", errors="replace")

    def _look_at_axes(self) -> None:
        """The controller must tell every axis that the task's arm has, and take its correction."""
        if self.rsi is None or self.task is None:
            return
        wanted_in, wanted_out = ["DEF_AIPos"], [f"A{i}" for i in range(1, 7)]
        if self.task.file.arm.linear_axis:
            wanted_in, wanted_out = [*wanted_in, "DEF_EIPos"], [*wanted_out, "E1"]
        sent = {element.tag for element in self.rsi.send}
        parts = [element.tag.partition(".") for element in self.rsi.receive]
        taken = {axis for word, _, axis in parts if word in {"AK", "AKorr", "EK", "EKorr"}}
        missing = [f"SEND {tag}" for tag in wanted_in if tag not in sent]
        missing += [
            f"RECEIVE {_CORRECTION[axis[0]]}.{axis}" for axis in wanted_out if axis not in taken
        ]
        if missing:
            raise ValueError(f"the task's arm needs {', '.join(missing)}")

    def _rsi_complaints(self) -> Iterator[Complaint]:
        """Name what the controller's file must not hold, or lacks."""
        if self.rsi is None:
            return
        given = self._get("rsi", "corrections", kind=str, default=Corrections.ABSOLUTE.value)
        constants: dict[str, Any] = self._get("rsi", "constants", kind=dict, default={}) or {}
        told = [*rsi_check.unfilled(self.rsi, constants)]
        if given in list(Corrections):
            told = [*rsi_check.exchange_errors(self.rsi, Corrections(given)), *told]
        if self.task is not None:
            told += rsi_check.gate_errors(self.rsi, self.task.file)
        for what in told:
            yield Complaint(("rsi", "config"), what)
        for tag, what in rsi_check.constant_errors(self.rsi, constants):
            yield Complaint(("rsi", "constants", tag), what)

    def _look_at_linear_axes(self) -> None:
        """Millimetres read as degrees would be another place."""
        linear = self._get("rsi", "linear_axes", kind=list)
        if linear is None or self.task is None or not self.task.file.arm.linear_axis:
            return
        if "E1" not in linear:
            raise ValueError("the task's arm stands on E1, which is linear")

    def _read_dbc(self) -> None:
        if not self._has("distance"):
            return
        name = self._get("distance", "dbc", kind=str, default="distance.dbc")
        message = self._get("distance", "message", kind=str, default="CIA406_TPDO1")
        signal = self._get("distance", "signal", kind=str, default="Position")
        if name and message and signal:
            path = files.find(name, self._base, files.PROTOCOL_DATA)
            text = files.read_text(path, MAX_LINK_BYTES)
            message_names(text)
            self.dbc = self.texts["dbc"] = text
            self._decoder = (text, message, signal)

    def _look_at_message(self) -> None:
        if self._decoder is not None:
            decoder, self._decoder = self._decoder, None
            DistanceDecoder(*decoder)
            self._decoder = decoder

    def _look_at_strength(self) -> None:
        strength = self._get("distance", "strength", kind=str)
        if self._decoder is not None and strength:
            DistanceDecoder(*self._decoder, strength=strength)

    def _read_keys(self) -> None:
        name = self._get("command", "udp", "keys", kind=str)
        if name:
            self.keys = read_keys(key_path(name, self._base))
            if not self.keys:
                raise ValueError("holds no key; make one with `linemate keygen`")

    def _look_at_directory(self, path: tuple[str, ...]) -> None:
        name = self._get(*path, kind=str)
        if name and not os.access(self._base / name, os.W_OK | os.X_OK):
            raise ValueError(f"not a directory that can be written: {self._base / name}")

    def _look_at_state(self) -> None:
        name = self._get("state", kind=str)
        if name and not os.access(self._base / name, os.W_OK | os.X_OK):
            raise ValueError(f"not a directory that can be written: {self._base / name}")

    def _look_at_socket(self) -> None:
        name = self._get("command", "socket", kind=str)
        if name is None:
            return
        path = self._base / name
        if len(os.fsencode(path)) > 107:
            raise ValueError("longer than the 107 bytes a socket's path may have")
        if not path.parent.is_dir():
            raise ValueError(f"no such directory: {path.parent}")

    def _look_at_groups(self, key: str) -> None:
        names = self._get("command", key, kind=list) or []
        group_ids(name for name in names if isinstance(name, str))

    def _look_at_can(self) -> None:
        can: dict[str, Any] = self._get("distance", "can", kind=dict) or {}
        nested = [key for key, value in can.items() if isinstance(value, (dict, list))]
        if nested:
            raise ValueError(f"should hold plain values: {', '.join(nested)}")
        if self._has("distance") and self._get("distance", "can", "interface", kind=str) is None:
            raise ValueError("needs an interface: slcan, socketcan, ...")
        if can.get("interface") == "udp_multicast" and can.get("hop_limit") != 0:
            raise ValueError("udp_multicast needs hop_limit: 0, else frames leave this host")

    def _look_at_address(self, path: tuple[str, ...]) -> None:
        text = self._get(*path, kind=str)
        if text is not None:
            ipaddress.ip_address(text)

    def _look_at_camera_peer(self) -> None:
        text = self._get("camera", "peer", kind=str)
        if text is not None:
            parse_peer(text)

    def _shared_ports(self) -> Iterator[Complaint]:
        """Two sockets on one port: the second could not be opened, or would hear the first's."""
        robot = None if self.rsi is None else self.rsi.port
        used: dict[int, list[tuple[str, str]]] = {}
        for path, default in (
            (("rsi",), robot),
            (("camera",), 49153),
            (("command", "udp"), 49160),
        ):
            if self._get(*path, kind=dict) is None and path != ("rsi",):
                continue
            port = self._get(*path, "port", kind=int, default=default)
            port = default if port is None and path == ("rsi",) else port
            bind = self._get(*path, "bind", kind=str, default="127.0.0.1") or "127.0.0.1"
            if not port:
                continue
            for other, address in used.get(port, []):
                if _overlap(bind, address):
                    yield Complaint((*path, "port"), f"{port} is {other}'s already")
            used.setdefault(port, []).append((f"{'.'.join(path)}.port", bind))

    def _look_at_consent(self) -> None:
        text = self._get("command", "udp", "bind", kind=str, default="127.0.0.1")
        remote = self._get("command", "udp", "allow_remote", kind=bool, default=False)
        if text and not remote and not ipaddress.ip_address(text).is_loopback:
            raise ValueError(f"{text} can be reached by others; say allow_remote: true")


def group_ids(names: Iterable[str]) -> frozenset[int]:
    """Return the ids of groups of this host.

    Raises:
        ValueError: there are no such groups.
    """
    ids: set[int] = set()
    unknown: list[str] = []
    for name in names:
        try:
            ids.add(int(name) if name.isdecimal() else grp.getgrnam(name).gr_gid)
        except KeyError:
            unknown.append(name)
    if unknown:
        raise ValueError(f"no such group: {', '.join(unknown)}. Make it, or give its number")
    return frozenset(ids)


def _overlap(first: str, second: str) -> bool:
    """Tell whether two addresses to listen on share one."""
    return first == second or not {first, second}.isdisjoint({"0.0.0.0", "::"})  # noqa: S104
