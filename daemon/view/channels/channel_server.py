"""Live server of the standard channels: Foxglove's WebSocket protocol, by ``foxglove-sdk``.

Invariants:
    * A process of its own. It can order nothing, and clients can send nothing.
    * A slow client drops its oldest messages: at most BACKLOG wait for it.
"""

import ipaddress
import signal
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Final

import foxglove
from foxglove.websocket import WebSocketServer

from linemate.daemon.recording.viewer_messages import INFO, root_link
from linemate.daemon.transport.client import Client
from linemate.daemon.view.cell import Cell, read_cell
from linemate.daemon.view.channels.channel_messages import (
    LAYOUT_FILE,
    TOPICS,
    ChannelMessage,
    StandardChannels,
    descriptor,
)
from linemate.daemon.view.channels.daemon_feed import DaemonFeed, Values, WallClock

PORT: Final = 8765  # where Foxglove looks for a server
BACKLOG: Final = 256  # messages for one client: a second
SAMPLED: Final = ("/wrench", "/distance", "/camera/pose")
WARNING: Final = 3


class LiveChannels:
    """Channels of one server, fed from a daemon's answers."""

    def __init__(self) -> None:
        self.context = foxglove.Context()
        self._channels = {
            topic: foxglove.Channel(
                topic,
                schema=foxglove.Schema(name=name, encoding="protobuf", data=descriptor(name)),
                message_encoding="protobuf",
                context=self.context,
            )
            for topic, name in TOPICS.items()
        }
        self._messages = StandardChannels(Cell())
        self._stamps: dict[str, int] = {}
        self._event_number = 0
        self._newest_ns = 0

    def is_sampled(self) -> bool:
        """Return whether a client has subscribed to a sensor."""
        return any(self._channels[topic].has_sinks() for topic in SAMPLED)

    def begin(self, scene: Values) -> None:
        """Take the cell of a daemon that has begun to answer."""
        self._messages = StandardChannels(read_cell(scene), root_link(str(scene.get("urdf", ""))))
        self._stamps.clear()
        self._event_number = 0

    def show(self, telemetry: Values, wall_ns: int) -> None:
        """Publish a moment, the duration of its replies, and new events."""
        self._newest_ns = wall_ns
        for message in self._messages.moment(telemetry, wall_ns):
            self._log(message)
        turnaround_us = telemetry.get("turnaround_us")
        if turnaround_us is not None:
            self._log(self._messages.durations(wall_ns, {"turnaround": 1e3 * turnaround_us}))
        for message in self._events(telemetry, wall_ns):
            self._log(message)

    def show_sensors(self, answer: Values, clock: WallClock) -> None:
        """Publish the samples that are new."""
        wall_ns = self._new("wrench", answer, clock)
        if wall_ns is not None:
            values = answer["wrench"]
            self._log(self._messages.wrench(wall_ns, values[:3], values[3:]))
        wall_ns = self._new("distance", answer, clock)
        if wall_ns is not None:
            self._log(self._messages.distance(wall_ns, answer["distance"]))
        wall_ns = self._new("camera", answer, clock)
        if wall_ns is not None:
            frame = str(answer["camera_frame"])
            self._log(self._messages.camera(wall_ns, frame, answer["camera"]))

    def complain(self, reason: str) -> None:
        """Publish why the daemon does not answer."""
        self._log(self._messages.line(self._newest_ns, reason, WARNING, "linemate view"))

    def _events(self, telemetry: Values, wall_ns: int) -> Iterator[ChannelMessage]:
        """Yield lines of the log for events that were not sent yet."""
        for number, stamp_ns, text in telemetry.get("happened") or ():
            if number > self._event_number:
                self._event_number = number
                at_ns = wall_ns + stamp_ns - telemetry["stamp_ns"]
                yield self._messages.line(at_ns, text, INFO, "linemated")

    def _new(self, name: str, answer: Values, clock: WallClock) -> int | None:
        """Return the time of a sample since the epoch [ns], None if it was shown already."""
        stamp_ns = answer.get(f"{name}_ns")
        if stamp_ns is None or self._stamps.get(name) == stamp_ns:
            return None
        wall_ns = clock.wall(stamp_ns)
        if wall_ns is not None:
            self._stamps[name] = stamp_ns
        return wall_ns

    def _log(self, message: ChannelMessage) -> None:
        topic, wall_ns, data = message
        self._channels[topic].log(data, log_time=max(wall_ns, 0))


def open_server(channels: LiveChannels, host: str, port: int) -> WebSocketServer:
    """Return a server that listens; port 0 takes any free one.

    Raises:
        RuntimeError, OSError: the port is taken.
    """
    return foxglove.start_server(
        name="linemate",
        host=host,
        port=port,
        capabilities=[],
        context=channels.context,
        message_backlog_size=BACKLOG,
    )


def serve(connect: Callable[[], Client], host: str, port: int) -> None:
    """Show a daemon until a signal ends it.

    Args:
        connect: makes a client of the daemon, for each attempt.
        host: numeric address to listen on.

    Raises:
        RuntimeError, OSError: the port is taken.
    """
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    channels = LiveChannels()
    server = open_server(channels, host, port)
    feed = DaemonFeed(
        connect,
        channels.begin,
        channels.show,
        channels.show_sensors,
        channels.is_sampled,
        channels.complain,
    )
    try:
        shown = f"[{host}]" if ":" in host else host
        print(f"ws://{shown}:{server.port}", flush=True)
        print(f"layout: {LAYOUT_FILE}", flush=True)
        if not ipaddress.ip_address(host).is_loopback:
            print("linemate view: all who reach this address can watch", file=sys.stderr)
        feed.start()
        ended.wait()
    finally:
        feed.end()
        server.stop()
