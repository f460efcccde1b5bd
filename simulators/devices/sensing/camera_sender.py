"""Emulated camera: encode a pose as one msgpack datagram.

Invariants:
    Pure: no socket, no clock.
    Stamps are on the camera's own clock, which has a configured offset.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from linemate.protocol.sensors.camera_codec import CameraMessage, encode


@dataclass(slots=True)
class CameraSender:
    """Encodes poses.

    Attributes:
        frame: frame the poses are given in.
        clock_offset_ns: its clock minus the clock of the stamps given to it [ns].
        sequence: number of the next message.
        reset: number of restarts of the tracker.
    """

    source: str = "camera"
    frame: str = "camera"
    object_id: str = "hub"
    clock_offset_ns: int = 0
    sequence: int = 0
    reset: int = 0

    def datagram(
        self,
        position: Sequence[float],
        quaternion: Sequence[float],
        covariance: Sequence[float] | None,
        *,
        exposure_ns: int,
        sent_ns: int,
    ) -> bytes:
        """The datagram of one pose.

        Args:
            position: object in the camera's frame [m].
            quaternion: its orientation, w x y z.
            covariance: 21 values of the upper triangle [m, rad], or None.
            exposure_ns: middle of the exposure [ns].
            sent_ns: moment of sending, on the same clock [ns].

        Returns:
            The datagram.

        Raises:
            CameraError: if no message can carry the pose.
        """
        x, y, z = position
        qw, qx, qy, qz = quaternion
        message = CameraMessage(
            v=1,
            src=self.source,
            seq=self.sequence,
            t_exp=exposure_ns + self.clock_offset_ns,
            t_tx=sent_ns + self.clock_offset_ns,
            frame=self.frame,
            obj=self.object_id,
            p=(x, y, z),
            q=(qw, qx, qy, qz),
            cov=None if covariance is None else tuple(covariance),
            reset=self.reset,
        )
        self.sequence += 1
        return encode(message)
