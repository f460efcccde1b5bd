"""Threads that keep a client of a daemon each: connect again, report trouble, end."""

import threading
from typing import Any

import pytest

from linemate.daemon.view import client_threads
from linemate.daemon.view.client_threads import ClientThreads

WAIT_S = 10.0  # for a thread, on a stalled machine


class _Client:
    """A client that does nothing, and counts its ends."""

    ends = 0

    def __enter__(self) -> "_Client":
        return self

    def __exit__(self, *_: object) -> None:
        type(self).ends += 1


@pytest.fixture(autouse=True)
def quick_retries(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_threads, "RETRY_S", 0.001)
    monkeypatch.setattr(_Client, "ends", 0)


def test_a_failed_loop_is_reported_and_tried_again_with_a_new_client() -> None:
    clients: list[_Client] = []
    reasons: list[str] = []
    third = threading.Event()

    def loop(client: Any) -> None:
        clients.append(client)
        if len(clients) == 3:
            third.set()
            threads.pause(WAIT_S)
            return
        raise ConnectionError("no answer")

    threads = ClientThreads(_Client, (loop,), reasons.append)  # type: ignore[arg-type]
    threads.start()
    assert third.wait(WAIT_S)
    threads.end()
    assert reasons == ["no answer"] * 2
    assert len({id(client) for client in clients}) == 3
    assert _Client.ends >= 2


def test_a_failure_without_a_text_is_reported_by_its_name() -> None:
    reasons: list[str] = []
    reported = threading.Event()

    def refuse() -> Any:
        raise TimeoutError

    def note(reason: str) -> None:
        reasons.append(reason)
        reported.set()

    threads = ClientThreads(refuse, (lambda _: None,), note)
    threads.start()
    assert reported.wait(WAIT_S)
    threads.end()
    assert reasons[0] == "TimeoutError"


def test_a_failure_after_the_order_to_end_is_not_reported() -> None:
    reasons: list[str] = []
    running = threading.Event()

    def loop(_: Any) -> None:
        running.set()
        threads.pause(WAIT_S)
        raise ConnectionError("closed")

    threads = ClientThreads(_Client, (loop,), reasons.append)  # type: ignore[arg-type]
    threads.start()
    assert running.wait(WAIT_S)
    threads.end()
    threads._threads[0].join(WAIT_S)
    assert threads.is_ending
    assert not threads._threads[0].is_alive()
    assert reasons == []


def test_an_end_does_not_wait_for_a_thread_that_hangs(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(client_threads, "END_S", 0.01)
    released = threading.Event()

    def hang(_: Any) -> None:
        released.wait(WAIT_S)

    threads = ClientThreads(_Client, (hang,), lambda _: None)  # type: ignore[arg-type]
    threads.start()
    threads.end()
    assert threads._threads[0].is_alive()
    released.set()
    threads._threads[0].join(WAIT_S)
