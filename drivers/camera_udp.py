"""Camera link: pose datagrams on a UDP port.

Invariants:
    * A wake reads at most ``budget`` datagrams, so that a flood on this port delays no robot.
    * ``CameraPeer`` decides who is heard. What a stranger sends reaches no decoder but its own.
    * While the camera's poses come, the kernel drops what others send.

Source: reference/reliability.md, 0 (findings 2 to 4).
"""

import copy
import logging
from collections.abc import Callable
from typing import Protocol

from linemate.drivers.backoff import Backoff
from linemate.drivers.camera_peer import TAKEOVER_S, CameraPeer, Peer, SenderRole
from linemate.drivers.datagrams import Address, Datagram, DatagramLink, DatagramSocket
from linemate.drivers.sole_sender import SoleSender
from linemate.protocol.errors import ProtocolError
from linemate.protocol.samples import CameraSample

BUDGET = 8

SILENCE_S = 0.25  # ten images; after that the kernel lets others through, to be judged here

IN_A_ROW = 5  # good poses that make a sender the camera

WARN_NS = 60_000_000_000  # between two lines about foreign poses in the log [ns]

log = logging.getLogger(__name__)

OnCamera = Callable[[CameraSample], None]


class PoseDecoder(Protocol):
    """What the link needs of a camera codec."""

    def feed(self, data: bytes, stamp_ns: int) -> CameraSample | None:
        """Decode one datagram; None for one that is well-formed but not wanted."""


class CameraLink(DatagramLink):
    """Hands camera samples to a callback.

    Attributes:
        status: the link's visible state. Counters: ``received``, ``samples``, ``ignored``,
            ``refused``, ``oversize``, ``foreign`` (not the camera), ``takeovers``,
            ``callback_errors``, ``kernel_drops`` (found no room, or came from others while a
            camera sent), ``stamps_refused``.
    """

    def __init__(
        self,
        decoder: PoseDecoder,
        on_sample: OnCamera,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        peer: Peer | None = None,
        name: str = "camera",
        budget: int = BUDGET,
        backoff: Backoff | None = None,
    ) -> None:
        super().__init__(name, host, port, backoff)
        self._fresh = copy.deepcopy(decoder)  # what each further sender begins with
        self._decoder = decoder
        self._decoders: dict[Address, PoseDecoder] = {}
        self._peer = CameraPeer(peer, IN_A_ROW)
        self._warned_ns: int | None = None
        self._on_sample = on_sample
        self._budget = budget
        self._sole = SoleSender(SILENCE_S, IN_A_ROW, lambda: self.status.last_sample_stamp_ns)

    def _read(self, transport: DatagramSocket) -> None:
        for _ in range(self._budget):
            datagram = transport.read()
            if datagram is None:
                break
            self._take(transport, datagram)

    def _release(self) -> None:
        self._sole.forget()
        super()._release()

    def _take(self, transport: DatagramSocket, datagram: Datagram) -> None:
        self.counters["received"] += 1
        if datagram.oversize:
            self.counters["oversize"] += 1
            return
        source, stamp_ns = datagram.source, datagram.stamp_ns
        judgement = self._peer.judge(source, stamp_ns)
        if judgement is SenderRole.FOREIGN:
            self._refuse(source, stamp_ns)
            return
        try:
            sample = self._decoder_of(source).feed(datagram.data, stamp_ns)
        except ProtocolError as error:
            self.counters["refused"] += 1
            log.debug("%s: %s", self.status.name, error)
            return
        if sample is None:
            self.counters["ignored"] += 1
            return
        if self._peer.good(source, stamp_ns):
            self._changed(source)
        if judgement is SenderRole.CANDIDATE and self._peer.present != source:
            self.counters["foreign"] += 1
            return
        self.counters["samples"] += 1
        self.status.last_sample_stamp_ns = sample.stamp_ns
        if self._peer.camera in {None, source}:
            # The kernel keeps others off for the camera alone: whoever has taken over from it
            # must not keep it off.
            self._sole.good(transport, source)
        self._deliver(sample)

    def _decoder_of(self, source: Address) -> PoseDecoder:
        """Return a sender's own decoder: numbers and clock of one are nothing to another."""
        if self._peer.camera is None:
            return self._decoder
        kept = {self._peer.camera, self._peer.present, source}
        self._decoders = {key: value for key, value in self._decoders.items() if key in kept}
        if source not in self._decoders:
            self._decoders[source] = copy.deepcopy(self._fresh)
        return self._decoders[source]

    def _changed(self, source: Address) -> None:
        """Note that another sender is heard."""
        camera, name = self._peer.camera, self.status.name
        if not self._decoders:
            self._decoders[source] = self._decoder
            log.info("%s: %s:%d is the camera from now on", name, *source[:2])
        elif source == camera:
            log.warning("%s: the camera %s:%d is back and heard again", name, *source[:2])
        else:
            self.counters["takeovers"] += 1
            log.warning(
                "%s: %s is silent for %.1f s or more: %s is heard until it is back. "
                "Set camera.peer to keep others off.",
                name, _text(camera), TAKEOVER_S, _text(source),
            )  # fmt: skip

    def _refuse(self, source: Address, stamp_ns: int) -> None:
        self.counters["foreign"] += 1
        if self._warned_ns is None or stamp_ns - self._warned_ns >= WARN_NS:
            self._warned_ns = stamp_ns
            log.warning(
                "%s: poses from %s refused: the camera is %s. %d refused so far.",
                self.status.name, _text(source), _text(self._peer.present),
                self.counters["foreign"],
            )  # fmt: skip

    def _deliver(self, sample: CameraSample) -> None:
        try:
            self._on_sample(sample)
        except Exception:
            self.counters["callback_errors"] += 1
            log.exception("%s: a sample's receiver failed", self.status.name)


def _text(source: Address | None) -> str:
    return "another by camera.peer" if source is None else f"{source[0]}:{source[1]}"
