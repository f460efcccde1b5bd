"""Camera link: pose datagrams on a UDP port.

Invariants:
    A wake reads at most ``budget`` datagrams, so that a flood on this port delays no reply to the
    robot.
    ``CameraPeer`` decides whose poses are used. Each sender has a decoder of its own.
    While the camera sends poses, the kernel drops what others send.
"""

import copy
import logging
from collections.abc import Callable
from typing import Protocol

from linemate.drivers.datagrams import Address, Datagram, DatagramSocket
from linemate.drivers.udp.camera_peer import TAKEOVER_S, CameraPeer, SenderRole
from linemate.drivers.udp.datagram_link import DatagramLink
from linemate.drivers.udp.sole_sender import SoleSender
from linemate.protocol.errors import ProtocolError
from linemate.protocol.numeric_peer import Peer
from linemate.protocol.stamped_samples import CameraSample

BUDGET = 8  # datagrams read at one wake
SILENCE_S = 0.25  # ten images; after that the kernel lets other senders through
IN_A_ROW = 5  # good poses that make a sender the camera
WARN_NS = 60_000_000_000  # between two log lines about foreign poses [ns]

log = logging.getLogger(__name__)

OnCamera = Callable[[CameraSample], None]


class PoseDecoder(Protocol):
    """What the link needs of a camera codec."""

    def feed(self, data: bytes, stamp_ns: int) -> CameraSample | None:
        """Decode one datagram; None for a well-formed one that is not used."""


class CameraLink(DatagramLink):
    """Delivers camera samples to a callback.

    Attributes:
        status: the link's visible state. Counters: ``received``, ``samples``, ``ignored``,
            ``refused``, ``oversize``, ``foreign`` (not the camera), ``takeovers``,
            ``callback_errors``, ``kernel_drops`` (queue full, or sent by others while the camera
            sent), ``stamps_refused``.
    """

    def __init__(
        self,
        decoder: PoseDecoder,
        on_sample: OnCamera,
        host: str = "127.0.0.1",
        port: int = 0,
        *,
        peer: Peer | None = None,
    ) -> None:
        super().__init__("camera", host, port)
        self._fresh = copy.deepcopy(decoder)  # initial state of each further sender's decoder
        self._decoder = decoder
        self._decoders: dict[Address, PoseDecoder] = {}
        self._peer = CameraPeer(peer, IN_A_ROW)
        self._warned_ns: int | None = None
        self._on_sample = on_sample
        self._sole_sender = SoleSender(
            SILENCE_S, IN_A_ROW, lambda: self.status.last_sample_stamp_ns
        )

    def _read(self, transport: DatagramSocket) -> None:
        for _ in range(BUDGET):
            datagram = transport.read()
            if datagram is None:
                break
            self._handle(transport, datagram)

    def _release(self) -> None:
        self._sole_sender.forget()
        super()._release()

    def _handle(self, transport: DatagramSocket, datagram: Datagram) -> None:
        self.counters["received"] += 1
        if datagram.oversize:
            self.counters["oversize"] += 1
            return
        source, stamp_ns = datagram.source, datagram.stamp_ns
        role = self._peer.role(source, stamp_ns)
        if role is SenderRole.FOREIGN:
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
        if self._peer.note_pose(source, stamp_ns):
            self._log_change(source)
        if role is SenderRole.CANDIDATE and self._peer.present != source:
            self.counters["foreign"] += 1
            return
        self.counters["samples"] += 1
        self.status.last_sample_stamp_ns = sample.stamp_ns
        if self._peer.camera in {None, source}:
            # The kernel drops other senders for the camera only: a sender that has taken over
            # must not lock the camera out.
            self._sole_sender.note_good(transport, source)
        self._deliver(sample)

    def _decoder_of(self, source: Address) -> PoseDecoder:
        """Return the sender's own decoder: its sequence numbers and clock are its own."""
        if self._peer.camera is None:
            return self._decoder
        kept = {self._peer.camera, self._peer.present, source}
        self._decoders = {key: value for key, value in self._decoders.items() if key in kept}
        if source not in self._decoders:
            self._decoders[source] = copy.deepcopy(self._fresh)
        return self._decoders[source]

    def _log_change(self, source: Address) -> None:
        """Log that the active sender has changed."""
        camera, name = self._peer.camera, self.status.name
        if not self._decoders:
            self._decoders[source] = self._decoder
            log.info("%s: %s:%d is the camera from now on", name, *source[:2])
        elif source == camera:
            log.warning("%s: the camera %s:%d is back: its poses are used again", name, *source[:2])
        else:
            self.counters["takeovers"] += 1
            log.warning(
                "%s: %s is silent for %.1f s or more: poses of %s are used until it is back. "
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
