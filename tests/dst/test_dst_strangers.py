"""Telegrams that are not the controller's own, and who may be answered with a correction."""

import re
from functools import partial

from linemate.drivers.datagrams import Address
from linemate.simulators.lab.faults.dst_controllers import second
from linemate.simulators.lab.faults.dst_plan import FaultPlan
from linemate.simulators.lab.faults.dst_strangers import (
    FIRST,
    OTHER_ADDRESS,
    OTHER_PORT,
    SECOND,
    SECOND_IPOC,
    Strangers,
)
from linemate.simulators.plants.scenario import Fault

TELEGRAM = b'<Rob Type="KUKA"><AIPos A1="0.0"/><IPOC>1200</IPOC></Rob>'


class Wire:
    """What was sent."""

    def __init__(self) -> None:
        self.sent: list[tuple[float, bytes, Address]] = []

    def __call__(self, at_s: float, data: bytes, source: Address) -> None:
        self.sent.append((at_s, data, source))


def strangers() -> Strangers:
    return Strangers(partial(second, FaultPlan(1), SECOND_IPOC), 0.012, 12)


def test_forged_telegrams_count_on_their_own_in_the_controllers_name() -> None:
    wire, found = Wire(), strangers()
    found.forge(Fault(1.0, "robot", "forged", 0.03, 100.0, 3), TELEGRAM, wire)
    assert [round(at, 3) for at, _, _ in wire.sent] == [1.01, 1.02, 1.03]
    assert {source for _, _, source in wire.sent} == {FIRST}
    counters = [int(re.findall(rb"<IPOC>(\d+)", data)[0]) for _, data, _ in wire.sent]
    assert counters == [2400, 2412, 2424]


def test_a_reply_to_a_forged_telegram_may_be_bare_and_nothing_else() -> None:
    found = strangers()
    found.forge(Fault(1.0, "robot", "forged", 0.03, 100.0, 3), TELEGRAM, Wire())
    bare = b'<Sen Type="ImFree"><IPOC>2412</IPOC></Sen>'
    moving = b'<Sen Type="ImFree"><AK A1="1.0"/><IPOC>2412</IPOC></Sen>'
    assert found.moved_by(bare) is None
    assert found.moved_by(moving) == "forged: telegram 2412 was answered with a correction"
    assert found.moved_by(moving.replace(b"2412", b"1200")) is None


def test_a_counter_that_the_controller_reaches_by_itself_is_no_longer_forged() -> None:
    found = strangers()
    found.forge(Fault(1.0, "robot", "forged", 0.03, 100.0, 1), TELEGRAM, Wire())
    moving = b'<Sen Type="ImFree"><AK A1="1.0"/><IPOC>2400</IPOC></Sen>'
    assert found.moved_by(moving) is not None
    found.passed(TELEGRAM.replace(b"1200", b"2400"))
    assert found.moved_by(moving) is None


def test_the_controller_may_come_from_another_port_or_address() -> None:
    found = strangers()
    assert found.source == FIRST
    found.readdress(Fault(1.0, "robot", "readdress"))
    assert found.source == OTHER_PORT
    found.readdress(Fault(1.0, "robot", "readdress", 0.0, 1.0))
    assert found.source == OTHER_ADDRESS


def test_a_second_controller_counts_on_while_it_is_there_and_begins_again_after_that() -> None:
    wire, found = Wire(), strangers()
    for is_there in (True, True, False, True):
        found.second(1.0, is_there=is_there, send=wire)
    counters = [int(re.findall(rb"<IPOC>(\d+)", data)[0]) for _, data, _ in wire.sent]
    assert counters[1] == counters[0] + 12
    assert counters[2] == counters[0]
    assert {source for _, _, source in wire.sent} == {SECOND}
