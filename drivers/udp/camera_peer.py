"""Decide which sender is the camera, from sources and arrival times.

Invariants:
    With a peer configured, no other sender is ever the camera.
    Without one, the first sender of ``needed`` good poses in a row is the camera until the process
    ends. Its poses are always used.
    While the camera has sent within ``takeover_s``, no other sender's poses are used.
    A sender that takes over from a silent camera is used until the camera sends again.
"""

import ipaddress
from enum import StrEnum, auto
from typing import Final

from linemate.drivers.datagrams import Address
from linemate.protocol.numeric_peer import Peer

TAKEOVER_S: Final = 5.0  # longer than an occlusion, shorter than a restart of the tracker


class SenderRole(StrEnum):
    """Role of a datagram's sender."""

    ACTIVE = auto()  # decoded and delivered
    CANDIDATE = auto()  # may take over: decoded, not delivered
    FOREIGN = auto()  # not decoded


class CameraPeer:
    """Decides whose poses are used.

    Args:
        peer: the only sender that may be the camera, None for the first one.
        needed: good poses in a row that make a sender the camera.
        takeover_s: silence of the camera after which another sender may take over [s].

    Attributes:
        camera: the sender that is the camera, None until there is one.
        present: the sender whose poses are used now.
    """

    def __init__(
        self, peer: Peer | None = None, needed: int = 5, takeover_s: float = TAKEOVER_S
    ) -> None:
        self.camera: Address | None = None
        self.present: Address | None = None
        self._peer = peer
        self._needed = needed
        self._takeover_ns = round(takeover_s * 1e9)
        self._last_ns = 0
        self._candidate: Address | None = None
        self._row = 0

    def role(self, source: Address, stamp_ns: int) -> SenderRole:
        """Return the role of a datagram's sender at its arrival [ns]."""
        if not self._may_be(source):
            return SenderRole.FOREIGN
        if self.present is None or source in {self.camera, self.present}:
            return SenderRole.ACTIVE
        is_silent = stamp_ns - self._last_ns >= self._takeover_ns
        return SenderRole.CANDIDATE if is_silent else SenderRole.FOREIGN

    def note_pose(self, source: Address, stamp_ns: int) -> bool:
        """Note a good pose of a sender that is not foreign, and its arrival [ns].

        Returns:
            Whether the active sender has changed.
        """
        if source == self.present:
            self._last_ns = stamp_ns
            self._candidate = None
            return False
        if source == self.camera:
            self._activate(source, stamp_ns)
            return True
        self._row = self._row + 1 if source == self._candidate else 1
        self._candidate = source
        if self._row < self._needed:
            return False
        self.camera = self.camera or source
        self._activate(source, stamp_ns)
        return True

    def _activate(self, source: Address, stamp_ns: int) -> None:
        self.present, self._last_ns = source, stamp_ns
        self._candidate, self._row = None, 0

    def _may_be(self, source: Address) -> bool:
        if self._peer is None:
            return True
        address, port = self._peer
        numeric = str(ipaddress.ip_address(source[0].partition("%")[0]))
        return numeric == address and port in {None, source[1]}
