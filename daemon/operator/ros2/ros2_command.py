"""``linemate ros2``: a ROS 2 node over zenoh for one daemon, from a process of its own."""

import argparse
import contextlib
import ipaddress
import os
import re
import signal
import threading
import time
from typing import TYPE_CHECKING, Any, Final

from linemate.daemon.command_line import OK, UsageError, bounded
from linemate.daemon.operator import console

if TYPE_CHECKING:
    import zenoh

ROUTER: Final = "tcp/127.0.0.1:7447"  # of rmw_zenoh
NICE: Final = 10  # the robot's processes of this machine go first
END_S: Final = 2.0  # for leaving the domain; the process ends then in any case
LOOK_S: Final = 0.5  # between two looks for a signal
REPORT_S: Final = 10.0  # between two lines about refused poses
DOMAIN: Final = "ROS_DOMAIN_ID"
_SOURCE: Final = re.compile(r"\s+at \S+\.rs:\d+\.?")


def add_parser(commands: Any, common: argparse.ArgumentParser) -> None:
    """Add the command."""
    about = "publish joints, poses and wrenches to ROS 2, take a camera's poses (extra 'ros2')"
    parser = commands.add_parser("ros2", parents=[common], help=about, description=about)
    parser.add_argument("--connect", metavar="ENDPOINT", help=f"zenoh router; {ROUTER}")
    parser.add_argument(
        "--listen", metavar="ENDPOINT", help="listen for peers there, without a router"
    )
    parser.add_argument(
        "--domain", type=_domain, metavar="N", help=f"domain id; that of {DOMAIN}, or 0"
    )
    parser.add_argument(
        "--prefix", type=_name, default="linemate", metavar="NAME",
        help="name of the node, and first part of its topics; linemate",
    )  # fmt: skip
    parser.add_argument(
        "--rate",
        type=bounded(float, 1.0, 50.0, "is not 1 to 50 Hz"),
        default=25.0,
        metavar="HZ",
        help="of all topics, 1 to 50; 25",
    )
    parser.add_argument(
        "--camera", type=_camera, metavar="ADDRESS:PORT",
        help="send the poses of PREFIX/camera_pose to this camera port of the daemon",
    )  # fmt: skip
    parser.add_argument("--object", default="hub", metavar="NAME", help="of those poses; hub")
    parser.add_argument(
        "--allow-remote", action="store_true", help="consent to an address that others can reach"
    )
    parser.set_defaults(run=main)


def main(args: argparse.Namespace) -> int:
    """Publish until a signal ends it."""
    endpoint = args.listen or args.connect or ROUTER
    if args.listen and args.connect:
        raise UsageError("--listen and --connect exclude each other")
    if not is_loopback(endpoint) and not args.allow_remote:
        raise UsageError(f"{endpoint} can be reached by others; add --allow-remote")
    try:
        domain = _domain(os.environ.get(DOMAIN) or "0") if args.domain is None else args.domain
    except argparse.ArgumentTypeError as error:
        raise UsageError(f"{DOMAIN}: {error}") from error
    try:
        import zenoh

        from linemate.daemon.operator.ros2 import ros2_messages, ros2_node
        from linemate.daemon.view.channels.daemon_feed import DaemonFeed
    except ImportError as error:
        raise UsageError(f"{error.name} is not installed; pip install linemate[ros2]") from error
    with contextlib.suppress(OSError):
        os.nice(NICE)
    console.connect(args).close()  # reports an unreadable key at once
    refusals = _Lines("camera pose refused: ")
    troubles = _Lines("")
    camera = None
    if args.camera is not None:
        reader = ros2_messages.CameraReader(args.object)
        camera = ros2_node.CameraInput(args.camera, reader, refusals.complain)
    end = threading.Event()
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: end.set())
    try:
        session = open_session(endpoint, is_router=not args.listen)
    except zenoh.ZError as error:
        raise UsageError(
            refused_session(str(error), endpoint, is_router=not args.listen)
        ) from error
    with session:
        node = ros2_node.Ros2Node(session, domain, args.prefix, camera)
        feed = DaemonFeed(
            lambda: console.connect(args),
            node.begin,
            node.show,
            node.show_sensors,
            node.is_sampled,
            troubles.complain,
            args.rate,
        )
        print(f"/{args.prefix} in domain {domain} at {endpoint}", flush=True)
        feed.start()
        # A signal that one of zenoh's threads gets does not wake this one.
        while not end.wait(LOOK_S):
            pass
        guard = threading.Timer(END_S, os._exit, (OK,))
        guard.daemon = True
        guard.start()
        feed.end()
        node.close()
        if camera is not None:
            camera.close()
    return OK


def refused_session(text: str, endpoint: str, *, is_router: bool) -> str:
    """Return why zenoh has opened no session and what to do.

    Args:
        text: of zenoh's error, which names lines of its source.
    """
    reason = " ".join(_SOURCE.sub("", text).split()).rstrip(".!")
    if is_router:
        reason += ". Start a router there (rmw_zenohd), name another with --connect, or --listen"
    return f"{endpoint}: {reason}"


def open_session(endpoint: str, *, is_router: bool) -> "zenoh.Session":
    """Open a session with one endpoint, without multicast and gossip.

    Args:
        endpoint: protocol, address and port, as in ``tcp/127.0.0.1:7447``.
        is_router: connect to a router there; listen for peers otherwise.

    Raises:
        zenoh.ZError: the endpoint cannot be had.
    """
    import json

    import zenoh

    config = zenoh.Config()
    for name, value in (
        # A router of rmw_zenoh passes nothing on between peers that do not know each other.
        ("mode", "client" if is_router else "peer"),
        ("scouting/multicast/enabled", False),
        ("scouting/gossip/enabled", False),
        ("connect/endpoints", [endpoint] if is_router else []),
        ("listen/endpoints", [] if is_router else [endpoint]),
    ):
        config.insert_json5(name, json.dumps(value))
    return zenoh.open(config)


def is_loopback(endpoint: str) -> bool:
    """Return whether a zenoh endpoint is on this machine alone."""
    address = endpoint.partition("/")[2]
    return address.startswith(("127.", "localhost:", "[::1]:"))


class _Lines:
    """Lines on standard error, one in REPORT_S, each with the number of those left out."""

    def __init__(self, head: str) -> None:
        self._head = head
        self._shown_s = -REPORT_S
        self._left_out = 0

    def complain(self, reason: str) -> None:
        """Print a reason, or count it."""
        now_s = time.monotonic()
        if now_s - self._shown_s < REPORT_S:
            self._left_out += 1
            return
        more = f" ({self._left_out} more)" if self._left_out else ""
        console.complain(f"{self._head}{reason}{more}")
        self._shown_s, self._left_out = now_s, 0


def _domain(text: str) -> int:
    if text.isdigit() and int(text) <= 232:
        return int(text)
    raise argparse.ArgumentTypeError(f"{text!r} is not a domain id, 0 to 232")


def _name(text: str) -> str:
    if re.fullmatch("[A-Za-z][A-Za-z0-9_]{0,62}", text):
        return text
    raise argparse.ArgumentTypeError(f"{text!r} is not a ROS name of letters, digits and _")


def _camera(text: str) -> tuple[str, int]:
    host, _, port = text.rpartition(":")
    with contextlib.suppress(ValueError):
        if 0 < int(port) < 65536:
            return str(ipaddress.IPv4Address(host)), int(port)
    raise argparse.ArgumentTypeError(f"{text!r} is not ADDRESS:PORT")
