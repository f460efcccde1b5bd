"""Emulated distance sensor on CAN: encode a reading as a frame.

Invariants:
    Pure: no port, no clock.
    A reading out of the message's range gives no frame and is counted.
"""

from dataclasses import dataclass

from linemate.protocol.sensors.distance import DistanceEncoder, DistanceError
from linemate.protocol.sensors.slcan import CanFrame


@dataclass(slots=True)
class CanSensor:
    """Encodes readings.

    Attributes:
        encoder: the sensor's message, from a DBC.
        mount: what the sensor reads when the conveyor unit is at s = 0 [m].
        out_of_range: readings the message could not carry.
    """

    encoder: DistanceEncoder
    mount: float = 0.0
    sent: int = 0
    out_of_range: int = 0

    def frame(self, position: float, strength: float | None = None) -> CanFrame | None:
        """The frame of one reading.

        Args:
            position: of the conveyor unit [m].
            strength: of the signal, where the message has one.

        Returns:
            The frame; None out of range.
        """
        try:
            can_id, data = self.encoder.encode(position + self.mount, strength)
        except DistanceError:
            self.out_of_range += 1
            return None
        self.sent += 1
        return CanFrame(can_id, data, extended=self.encoder.extended)
