"""Read and write whole numbers in a CAN frame at places that are resolved once.

Invariants:
    Only whole numbers of up to 64 bits in messages without multiplexers; cantools does the rest.
    The results are those of cantools.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    from cantools.database.can import Message, Signal

MAX_BITS = 64


@dataclass(frozen=True, slots=True)
class Bits:
    """Place of one number.

    Attributes:
        order: byte order of the frame.
        length: of the message [bytes].
        mask: the number's bits, shifted to bit 0.
        sign: the sign bit of a signed number, else 0.
    """

    order: Literal["little", "big"]
    length: int
    shift: int
    mask: int
    sign: int

    def read(self, data: bytes) -> int:
        """Return the number of a frame that is long enough."""
        raw = int.from_bytes(data[: self.length], self.order) >> self.shift & self.mask
        return (raw ^ self.sign) - self.sign

    def fits(self, count: int) -> bool:
        """Whether a number fits the place."""
        return -self.sign <= count <= (self.sign - 1 if self.sign else self.mask)

    def packed(self, count: int) -> bytes:
        """Return a frame with this number, which fits, and zeros."""
        return ((count & self.mask) << self.shift).to_bytes(self.length, self.order)


def find(message: Message, names: Sequence[str]) -> dict[str, Bits] | None:
    """Return the places of signals by name, None if cantools must decode one of them."""
    if message.is_multiplexed():
        return None
    places = {s.name: _bits(s, message.length) for s in message.signals if s.name in names}
    plain = {name: bits for name, bits in places.items() if bits is not None}
    return plain if len(plain) == len(set(names)) else None


def _bits(signal: Signal, length: int) -> Bits | None:
    size = signal.length
    if signal.is_float or size > MAX_BITS:
        return None
    if signal.byte_order == "little_endian":
        order: Literal["little", "big"] = "little"
        shift = signal.start
    else:
        # A DBC gives the highest bit of a big-endian number; bytes count up, bits count down.
        order = "big"
        highest = 8 * (signal.start // 8) + 7 - signal.start % 8
        shift = 8 * length - highest - size
    if shift < 0 or shift + size > 8 * length:
        return None
    return Bits(order, length, shift, (1 << size) - 1, 1 << (size - 1) if signal.is_signed else 0)
