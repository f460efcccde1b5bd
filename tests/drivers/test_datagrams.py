"""From the kernel's wall clock stamps to monotonic arrivals."""

import socket
import struct
import time

from linemate.drivers.datagrams import (
    ANCILLARY_BYTES,
    SO_RXQ_OVFL,
    SO_TIMESTAMPNS,
    ArrivalClock,
    paired_clocks,
    read_ancillary,
    request_kernel_stamps,
)

MS = 1_000_000


def _clock(empty_ns: int) -> ArrivalClock:
    clock = ArrivalClock()
    clock.drained(empty_ns)
    return clock


def test_an_age_is_taken_off_the_monotonic_clock() -> None:
    clock = _clock(empty_ns=1_000 * MS)
    assert clock.arrival(500 * MS, now_ns=1_030 * MS, realtime_ns=520 * MS) == 1_010 * MS
    assert clock.refused == 0


def test_an_age_greater_than_the_last_empty_read_is_refused_and_counted() -> None:
    clock = _clock(empty_ns=1_000 * MS)
    stamp_ns = clock.arrival(0, now_ns=1_030 * MS, realtime_ns=3_600_000 * MS)
    assert stamp_ns == 1_030 * MS
    assert clock.refused == 1


def test_a_datum_cannot_have_come_before_the_one_that_was_read_before_it() -> None:
    clock = _clock(empty_ns=0)
    assert clock.arrival(990 * MS, now_ns=5_000 * MS, realtime_ns=1_000 * MS) == 4_990 * MS
    # The wall clock has stepped by a second.
    assert clock.arrival(1_000 * MS, now_ns=5_010 * MS, realtime_ns=2_010 * MS) == 5_010 * MS
    assert clock.refused == 1


def test_a_wall_clock_that_stepped_back_cannot_make_a_datum_younger_than_now() -> None:
    clock = _clock(empty_ns=1_000 * MS)
    assert clock.arrival(3_600_000 * MS, now_ns=1_030 * MS, realtime_ns=0) == 1_030 * MS
    assert clock.refused == 1


def test_the_two_clocks_being_read_apart_is_no_reason_to_refuse() -> None:
    clock = _clock(empty_ns=1_000 * MS)
    assert clock.arrival(501_000, now_ns=1_030 * MS, realtime_ns=500_000) == 1_030 * MS
    assert clock.refused == 0


def test_data_without_a_kernel_stamp_are_stamped_at_reading() -> None:
    clock = _clock(empty_ns=0)
    assert clock.arrival(None, now_ns=7, realtime_ns=9) == 7
    assert clock.missing == 1


def test_control_messages_of_others_are_passed_over() -> None:
    stamp = struct.pack("@ll", 3, 4)
    ancillary = [
        (socket.SOL_IP, SO_TIMESTAMPNS, stamp),
        (socket.SOL_SOCKET, SO_TIMESTAMPNS, stamp[:8]),
        (socket.SOL_SOCKET, SO_TIMESTAMPNS, stamp),
        (socket.SOL_SOCKET, SO_RXQ_OVFL, struct.pack("@I", 5)),
    ]
    assert read_ancillary(ancillary) == (3_000_000_004, 5)


def test_the_paired_clocks_run_together() -> None:
    first_ns, first_realtime_ns = paired_clocks()
    second_ns, second_realtime_ns = paired_clocks()
    elapsed_ns = (second_ns - first_ns) - (second_realtime_ns - first_realtime_ns)
    assert abs(elapsed_ns) < 50 * MS


def test_a_datagram_that_waited_is_as_old_as_it_waited() -> None:
    # Right after the first request for stamps the kernel does not stamp yet, and fills in the
    # moment of reading.
    for _ in range(20):
        sent_ns, read_ns, stamp_ns, refused = _send_and_wait(0.03)
        assert refused == 0
        if stamp_ns < read_ns - 25 * MS:
            break
    assert sent_ns - MS <= stamp_ns <= read_ns - 25 * MS


def _send_and_wait(wait_s: float) -> tuple[int, int, int, int]:
    """Monotonic times of sending and reading, the arrival between them, and refused stamps."""
    with (
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver,
        socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender,
    ):
        receiver.bind(("127.0.0.1", 0))
        request_kernel_stamps(receiver)
        clock = ArrivalClock()
        sent_ns = time.monotonic_ns()
        sender.sendto(b"x", receiver.getsockname())
        time.sleep(wait_s)
        _, ancillary, _, _ = receiver.recvmsg(16, ANCILLARY_BYTES)
        now_ns, realtime_ns = paired_clocks()
    stamp_realtime_ns, _ = read_ancillary(ancillary)
    assert stamp_realtime_ns is not None
    return sent_ns, now_ns, clock.arrival(stamp_realtime_ns, now_ns, realtime_ns), clock.refused
