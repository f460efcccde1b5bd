"""Checks of a configuration's addresses, ports, directories and groups, and of a task's gates.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
- No port is opened and no file is written.
"""

import grp
import ipaddress
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import urlsplit

from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.core.tracking.task import Gate, TaskFile
from linemate.daemon.near_names import near_names
from linemate.protocol.numeric_peer import parse_peer

T = TypeVar("T")

LONGEST_SOCKET_PATH = 107  # bytes, of sockaddr_un
BITRATES = (10_000, 1_000_000)  # of CAN [bit/s]
DRIFT_LEARNED = "a longer dead time would be learned as a slower servo."

_ADDRESSES: tuple[tuple[str, ...], ...] = (
    ("rsi", "bind"),
    ("rsi", "peer"),
    ("egm", "bind"),
    ("egm", "peer"),
    ("fanuc", "peer"),
    ("fanuc", "bind"),
    ("camera", "bind"),
    ("command", "udp", "bind"),
)
_DIRECTORIES: tuple[tuple[str, ...], ...] = (
    ("recording", "directory"),
    ("realtime", "incidents"),
    ("production", "records"),
    ("state",),
)
_BROADCAST = ipaddress.IPv4Address("255.255.255.255")
_LOOPBACK = "127.0.0.1"
_USUAL_BUSES = {
    "slcan": "/dev/serial/by-id/usb-...",
    "socketcan": "can0",
    "udp_multicast": "239.74.163.2",
    "virtual": "0",
}
"""Interfaces of python-can that need no import to be known, each with a channel."""


@dataclass(frozen=True, slots=True)
class PlainValues:
    """Plain values of a configuration, of any kind."""

    value: Any

    def get(self, *path: str, kind: type[T], default: T | None = None) -> T | None:
        """Return a value of one kind, the default if its key is absent, else None."""
        value = self.value
        for part in path:
            if not isinstance(value, dict):
                return None
            if part not in value:
                return default
            value = value[part]
        return value if isinstance(value, kind) else None

    def has(self, *section: str) -> bool:
        """Return whether a section is given."""
        return self.get(*section, kind=dict) is not None


def complaints(
    values: PlainValues, base: Path, robot: tuple[str, int | None]
) -> Iterator[Complaint]:
    """Yield what is wrong with addresses, ports, directories and groups.

    Args:
        base: directory of the configuration file.
        robot: section of the controller's family, and its port if the section names none; None
            if that cannot be read.
    """
    for path in _DIRECTORIES:
        yield from _complaint(path, _check_directory, base, values.get(*path, kind=str))
    socket = values.get("command", "socket", kind=str)
    yield from _complaint(("command", "socket"), _check_socket, base, socket)
    for key in ("operate_groups", "view_groups"):
        names = values.get("command", key, kind=list) or []
        known = [name for name in names if isinstance(name, str)]
        yield from _complaint(("command", key), group_ids, known)
    if values.has("distance"):
        can: dict[str, Any] = values.get("distance", "can", kind=dict) or {}
        yield from _complaint(("distance", "can"), _check_can, can)
        url = values.get("force_torque", "url", kind=str)
        yield from _complaint(("force_torque", "url"), _check_own_device, url, can)
    yield from _complaint(
        ("force_torque", "url"), _check_url, values.get("force_torque", "url", kind=str)
    )
    for path in _ADDRESSES:
        address = values.get(*path, kind=str)
        if address is not None:
            yield from _complaint(path, ipaddress.ip_address, address)
    peer = values.get("camera", "peer", kind=str)
    if peer is not None:
        yield from _complaint(("camera", "peer"), parse_peer, peer)
    for section in ("rsi", "egm", "fanuc", "camera"):
        bind = values.get(section, "bind", kind=str, default=_LOOPBACK)
        peer = values.get(section, "peer", kind=str)
        yield from _complaint((section, "bind"), _check_reached, bind, peer)
        yield from _complaint((section, "peer"), _check_host, peer)
    if values.has("learning") and drifts(values):
        yield Complaint(("learning",), f"control.drift is set: {DRIFT_LEARNED} Remove one of them.")
    bind = values.get("command", "udp", "bind", kind=str, default=_LOOPBACK)
    remote = values.get("command", "udp", "allow_remote", kind=bool, default=False)
    if bind and not remote:
        yield from _complaint(("command", "udp", "bind"), _check_consent, bind)
    yield from _shared_ports(values, *robot)


def drifts(values: PlainValues) -> bool:
    """Return whether dead times may drift, which servos that are learned contradict."""
    return any(values.get("control", "drift", key, kind=float) for key in ("shorter", "longer"))


def _complaint(
    path: tuple[str, ...], check: Callable[..., object], *arguments: Any
) -> Iterator[Complaint]:
    try:
        check(*arguments)
    except ValueError as error:
        yield Complaint(path, str(error))


def _check_directory(base: Path, name: str | None) -> None:
    if name and not os.access(base / name, os.W_OK | os.X_OK):
        raise ValueError(f"not a directory that can be written: {base / name}")


def _check_socket(base: Path, name: str | None) -> None:
    if name is None:
        return
    path = base / name
    length = len(os.fsencode(path))
    if length > LONGEST_SOCKET_PATH:
        raise ValueError(
            f"path of a socket too long: {length} bytes, limit {LONGEST_SOCKET_PATH}. Shorten it."
        )
    if not os.access(path.parent, os.X_OK):
        raise ValueError(f"no such directory: {path.parent}")
    if path.exists() and not path.is_socket():
        raise ValueError(f"exists and is not a socket: {path}. Give a path of its own.")


def _check_can(can: dict[str, Any]) -> None:
    nested = [key for key, value in can.items() if isinstance(value, (dict, list))]
    if nested:
        raise ValueError(f"should hold plain values: {', '.join(nested)}")
    interface = can.get("interface")
    if interface is None or isinstance(interface, (bool, int, float)):
        raise ValueError("needs an interface: slcan, socketcan, ...")
    if interface not in _USUAL_BUSES:
        from can.interfaces import VALID_INTERFACES  # 0.2 s, for a name that is seldom or wrong

        if interface not in VALID_INTERFACES:
            near = near_names(str(interface), VALID_INTERFACES)
            raise ValueError(f"python-can has no interface {interface!r}{near}")
    if interface in {"slcan", "socketcan"} and not can.get("channel"):
        raise ValueError(f"{interface} needs a channel, such as {_USUAL_BUSES[interface]}")
    bitrate = can.get("bitrate", BITRATES[0])
    if not isinstance(bitrate, int) or not BITRATES[0] <= bitrate <= BITRATES[1]:
        raise ValueError(f"bitrate should be {BITRATES[0]} to {BITRATES[1]} bit/s, not {bitrate!r}")
    if interface == "udp_multicast" and can.get("hop_limit") != 0:
        raise ValueError("udp_multicast needs hop_limit: 0, else frames leave this host")


def _check_own_device(url: str | None, can: dict[str, Any]) -> None:
    """Refuse one serial device for both sensors: names may be links to the same one."""
    channel = can.get("channel")
    if url is None or not isinstance(channel, str):
        return
    devices = [os.path.realpath(name.partition("@")[0]) for name in (url, channel)]
    if url.startswith("/") and devices[0] == devices[1]:
        raise ValueError(f"{url} is distance.can.channel's already. Give each sensor its device.")


def _check_url(url: str | None) -> None:
    """Refuse what names neither a device nor a serial server; ``virtual`` is an emulated one."""
    if not url or url.startswith("/") or url == "virtual":
        return
    with suppress(ValueError):
        server = urlsplit(url)
        if server.scheme == "socket" and server.hostname and server.port:
            return
    raise ValueError(
        f"{url!r} is not the path of a device, such as /dev/serial/by-id/usb-..., "
        "nor socket://HOST:PORT"
    )


def _check_reached(bind: str | None, peer: str | None) -> None:
    """Refuse a peer that can send nothing to the address that is listened on."""
    if bind is None or peer is None:
        return
    try:
        own, other = ipaddress.ip_address(bind), ipaddress.ip_address(parse_peer(peer)[0])
    except ValueError:  # which has its own complaint
        return
    differ = own.version != other.version or own.is_loopback is not other.is_loopback
    if differ and not own.is_unspecified:
        raise ValueError(
            f"{peer} cannot send to {bind}. Give the address of this host's interface to it."
        )


def _check_host(peer: str | None) -> None:
    """Refuse a peer that is no single host: nothing comes from it, and no one is answered."""
    try:
        address = ipaddress.ip_address(parse_peer(peer or "")[0])
    except ValueError:  # which has its own complaint
        return
    if address.is_multicast or address.is_unspecified or address == _BROADCAST:
        raise ValueError(f"{address} is the address of no single host. Give that of the sender.")


def _check_consent(bind: str) -> None:
    if not ipaddress.ip_address(bind).is_loopback:
        raise ValueError(
            f"{bind} can be reached by other hosts. Set allow_remote: true to allow it."
        )


def _shared_ports(values: PlainValues, kind: str, own_port: int | None) -> Iterator[Complaint]:
    """Yield a port that two sockets would share: the second could not be opened."""
    used: dict[int, list[tuple[str, str]]] = {}
    robot = (kind,)
    for path, default in ((robot, own_port), (("camera",), 49153), (("command", "udp"), 49160)):
        if path != robot and not values.has(*path):
            continue
        port = values.get(*path, "port", kind=int, default=default)
        port = default if port is None and path == robot else port
        bind = values.get(*path, "bind", kind=str, default=_LOOPBACK) or _LOOPBACK
        if not port:
            continue
        for other, address in used.get(port, []):
            if _overlap(bind, address):
                yield Complaint((*path, "port"), f"{port} is {other}'s already")
        used.setdefault(port, []).append((f"{'.'.join(path)}.port", bind))


def _overlap(first: str, second: str) -> bool:
    return first == second or not {first, second}.isdisjoint({"0.0.0.0", "::"})  # noqa: S104


def group_ids(names: Iterable[str]) -> frozenset[int]:
    """Return the ids of groups of this host, by name or number.

    Raises:
        ValueError: a group is not known.
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


def waiting_gates(task: TaskFile) -> Iterator[tuple[str, str]]:
    """Yield each gate that waits for a signal: what waits for what, and the key to set instead."""
    for i, waypoint in enumerate(task.waypoints):
        instead = {
            Gate.SCREWS_FIXED: ("fixed_after", task.tool.fixed_after),
            Gate.WHEEL_RELEASED: ("released_after", task.tool.released_after),
        }.get(waypoint.gate)
        if instead is not None and instead[1] is None:
            yield f"waypoints[{i}] waits for {waypoint.gate}", f"tool.{instead[0]}"
