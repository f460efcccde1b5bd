"""Emulated camera on a UDP socket.

Invariants:
    A datagram is sent at once or dropped.
    The stamp is the time of sending.
"""

import time
from collections.abc import Sequence

from linemate.simulators.devices.links.endpoint import Address, Endpoint
from linemate.simulators.devices.sensing.camera_sender import CameraSender


class CameraUdp:
    """Sends poses to one receiver."""

    def __init__(self, sender: CameraSender, target: Address) -> None:
        self.sender = sender
        self.target = target
        self.sent = 0
        self._endpoint: Endpoint | None = None

    def open(self) -> None:
        """Open a socket.

        Raises:
            OSError: if none can be had.
        """
        self._endpoint = Endpoint.bound(_source_for(self.target[0]))

    def close(self) -> None:
        """Close the socket."""
        if self._endpoint is not None:
            self._endpoint.close()
            self._endpoint = None

    def emit(
        self,
        position: Sequence[float],
        quaternion: Sequence[float],
        covariance: Sequence[float] | None,
        exposure_ns: int,
    ) -> None:
        """Send one pose now.

        Args:
            position: object in the camera's frame [m].
            quaternion: its orientation, w x y z.
            covariance: 21 values of the upper triangle [m, rad], or None.
            exposure_ns: monotonic middle of the exposure [ns].
        """
        now_ns = time.monotonic_ns()
        self.send_raw(
            self.sender.datagram(
                position, quaternion, covariance, exposure_ns=exposure_ns, sent_ns=now_ns
            )
        )

    def send_raw(self, data: bytes) -> None:
        """Send any datagram."""
        if self._endpoint is not None and self._endpoint.send(data, self.target):
            self.sent += 1

    def counters(self) -> dict[str, int]:
        """What happened, by name."""
        unsent = 0 if self._endpoint is None else self._endpoint.unsent
        return {"sent": self.sent, "unsent": unsent}


def _source_for(host: str) -> str:
    """The local address to send from: loopback stays on loopback."""
    return "127.0.0.1" if host.startswith("127.") else "0.0.0.0"  # noqa: S104 - any interface
