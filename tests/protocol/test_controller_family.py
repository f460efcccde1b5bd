import struct

import pytest

from linemate.daemon.config.files import PROTOCOL_DATA
from linemate.protocol.controller_family import family, refusal
from linemate.protocol.controller_link import ControllerError
from linemate.protocol.egm.egm_codec import EgmCodec
from linemate.protocol.egm.egm_link import EgmLink
from linemate.protocol.egm.messages import EgmPosition, RobotMessage
from linemate.protocol.fanuc.fanuc_link import FanucLink
from linemate.protocol.rsi.codec import RsiCodec, parse_config
from linemate.protocol.rsi.rsi_link import RsiLink

RSI = b"<Rob TYPE='KUKA'><IPOC>1</IPOC></Rob>"
FANUC = struct.pack(">III", 202, 3, 1).ljust(388, b"\0")
EGM = EgmCodec().format_robot(RobotMessage(300, 1, EgmPosition((0.0,) * 6)))


@pytest.mark.parametrize(
    ("data", "kind"),
    [
        (RSI, "rsi"),
        (b" \r\n<rob>", "rsi"),
        (FANUC, "fanuc"),
        (struct.pack(">III", 204, 4, 1).ljust(416, b"\0"), "fanuc"),
        (EGM, "egm"),
        (b"", None),
        (FANUC[:-1], None),
        (b"<Sen/>", None),
        (b"\x0a", None),
    ],
)
def test_a_datagram_shows_its_family(data: bytes, kind: str | None) -> None:
    assert family(data) == kind


def test_a_controller_of_another_family_is_named_with_both() -> None:
    link = EgmLink(EgmCodec(), 0.004)
    for data, name in ((RSI, "KUKA RSI"), (FANUC, "FANUC Stream Motion")):
        with pytest.raises(
            ControllerError, match=f"the telegram is {name}: configured is ABB EGM. Set controller"
        ):
            link.read(data, 0)
    rsi = RsiLink(RsiCodec(parse_config((PROTOCOL_DATA / "rsi_joints.xml").read_bytes())))
    with pytest.raises(ControllerError, match="the telegram is ABB EGM: configured is KUKA RSI"):
        rsi.read(EGM, 0)
    for data, name in ((RSI, "KUKA RSI"), (EGM, "ABB EGM")):
        with pytest.raises(
            ControllerError, match=f"the telegram is {name}: configured is FANUC Stream Motion"
        ):
            FanucLink(3).read(data, 0)
    error = ControllerError("damaged")
    assert refusal(error, EGM, "egm") is error
    assert refusal(error, b"?", "egm") is error
