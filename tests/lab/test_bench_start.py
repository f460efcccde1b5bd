"""What the bench calls an answer, and what it prints of a start."""

import socket
import threading
from collections.abc import Callable

import pytest

from linemate.simulators.lab.bench import bench_start
from linemate.simulators.lab.bench.bench_start import AskingController


def answered_by(reply: Callable[[bytes], bytes]) -> bool:
    """Ask once; a thread returns the reply to the counter of the telegram."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as server:
        server.bind(("127.0.0.1", 0))

        def serve() -> None:
            data, source = server.recvfrom(2048)
            begin = data.find(b"<IPOC>") + 6
            server.sendto(reply(data[begin : data.find(b"<", begin)]), source)

        thread = threading.Thread(target=serve)
        thread.start()
        controller = AskingController(server.getsockname())
        try:
            # A cycle is too short for a thread on a busy machine.
            return any(controller.cycle() for _ in range(3))
        finally:
            controller.close()
            thread.join(5.0)


def test_a_reply_is_correct_with_the_counter_of_its_telegram_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(bench_start, "CYCLE_S", 0.5)
    assert answered_by(lambda counter: b"<Sen><IPOC>%b</IPOC></Sen>" % counter)
    assert not answered_by(lambda counter: b"<Sen><IPOC>%d</IPOC></Sen>" % (int(counter) - 4))


def test_a_telegram_to_no_one_is_not_answered() -> None:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        address = free.getsockname()
    controller = AskingController(address)
    assert not any(controller.cycle() for _ in range(3))
    assert (controller.asked, controller.answered) == (3, 0)
    controller.close()


def test_each_figure_has_a_row() -> None:
    names = ("ready_s", "ready_cpu_s", "back_s", "back_cpu_s", "status_cpu_s")
    shares = ("init_share", "stepped_share", "idle_share", "gone_share")
    measured = dict.fromkeys((*names, *shares), 0.25)
    rows = list(bench_start.rows(measured))
    assert len(rows) == len(measured)
    assert rows[0] == ("processor time to READY", "0.25 s")
    assert rows[-1] == ("of a core after that robot has gone", "25.0 %")
