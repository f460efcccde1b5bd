"""Which family of controllers a datagram comes from, to name a controller of the wrong kind.

Reference: KUKA RSI, FANUC Stream Motion (status packets), ABB EGM (egm.proto).
"""

import re
import struct

from linemate.protocol.controller_link import ControllerError

FAMILIES = {"rsi": "KUKA RSI", "fanuc": "FANUC Stream Motion", "egm": "ABB EGM"}

_XML = re.compile(rb"\s*<\s*rob\b", re.IGNORECASE)
_STATUS = struct.Struct(">II")
_STATUS_BYTES = {(202, 388), (204, 416)}  # type and length of a status packet
_EGM_HEADER = b"\x0a"  # field 1, an embedded message
_EGM_SEQUENCE = b"\x08"  # its field 1, a varint


def family(data: bytes) -> str | None:
    """Return the family's kind in the configuration, None if it is none of them."""
    if _XML.match(data):
        return "rsi"
    if len(data) >= _STATUS.size and (_STATUS.unpack_from(data)[0], len(data)) in _STATUS_BYTES:
        return "fanuc"
    if data[:1] == _EGM_HEADER and data[2:3] == _EGM_SEQUENCE:
        return "egm"
    return None


def refusal(error: ControllerError, data: bytes, own: str) -> ControllerError:
    """Return the error of a datagram's codec, or one that names the family that has sent it.

    Args:
        own: kind that is configured.
    """
    kind = family(data)
    if kind is None or kind == own:
        return error
    return ControllerError(
        f"the telegram is {FAMILIES[kind]}: configured is {FAMILIES[own]}. "
        f"Set controller.kind to {kind}, or change the address at that controller."
    )
