"""The whole service on the loopback: a controller, an operator, a camera, in one short session."""

import asyncio
import contextlib
import os
import signal
import socket
import threading
import time
from collections.abc import AsyncIterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from loops import run, until
from mcap.reader import make_reader
from served_app import CONFIG, CYCLE_S, Controller, Running, Serve, repeated_when_delayed, serve_in

from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.states import State
from linemate.daemon.recording.format import STEP
from linemate.daemon.recording.step_codec import decode
from linemate.daemon.service import app as app_module
from linemate.daemon.service.app import App, StartError
from linemate.daemon.service.command_server import CommandPort
from linemate.daemon.service.host.notify import Notifier
from linemate.daemon.transport.client import RefusedError


@pytest.fixture
def serve(tmp_path: Path, parameters: Parameters) -> Serve:
    return serve_in(tmp_path, parameters)


@repeated_when_delayed
def test_every_telegram_is_answered_at_rest_and_recorded(
    serve: Serve, tmp_path: Path, task: Task
) -> None:
    overdue: list[int] = []

    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            await controller.cycles(20)
            await controller.answers(20)
            status = running.app.status()
            overdue.append(status["telegrams"]["overdue"])
            assert status["state"] == "idle"
            # On a busy machine the clock's deadline may come before one of them.
            assert sum(status["telegrams"][kind] for kind in ("normal", "gap", "late")) == 19
            assert status["turnaround_us"]["max"] is not None
            assert status["links"]["robot"]["up"]
            assert status["complaints"] == ("link camera is silent",)
            assert status["health"] == "degraded"
        assert [reply.ipoc for reply in controller.replies] == controller.sent
        assert all(reply.joints == (0.0,) * 6 for reply in controller.replies)

    run(main())
    (path,) = tmp_path.glob("*.mcap")
    with path.open("rb") as stream:
        records = [decode(m.data) for _, _, m in make_reader(stream).iter_messages(STEP)]
    answered = [record for record in records if record.counter is not None]
    # A step that the clock made before its late telegram is recorded without it.
    assert 20 - overdue[-1] <= len(answered) <= 20
    assert [record.inputs.k for record in records] == list(range(len(records)))


@contextlib.asynccontextmanager
async def silent_robot(
    serve: Serve, task: Task
) -> AsyncIterator[tuple[Running, Controller, float]]:
    """A daemon whose robot has fallen silent, its controller, and since when it is [s]."""
    async with serve() as running:
        controller = running.controller(task)
        await controller.cycles(20)
        silent_s = time.monotonic()
        await until(lambda: running.app.status()["state"] == "init", 2.0)
        yield running, controller, silent_s


@repeated_when_delayed
def test_without_a_robot_and_a_viewer_the_daemon_rests_and_is_back_at_the_first_telegram(
    serve: Serve, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "REST_AFTER_S", 0.1)

    async def main() -> None:
        async with silent_robot(serve, task) as (running, controller, silent_s):
            app = running.app
            await asyncio.sleep(0.2)
            steps, wakes = app.status()["steps"], app._timer.lateness.wakes
            await asyncio.sleep(0.6)
            assert app.status()["steps"] == steps
            assert app._timer.lateness.wakes - wakes < 0.5 * 0.6 / CYCLE_S
            assert (await running.ask("status"))["state"] == "init"
            for _ in range(round((time.monotonic() - silent_s) / CYCLE_S)):
                controller.skip()
            await controller.cycles(30)
            await until(lambda: app.status()["state"] == "idle", 2.0)
            # The exchange confirms a counter that does not fit the time by some telegrams.
            assert [reply.ipoc for reply in controller.replies[-20:]] == controller.sent[-20:]
            assert app.status()["steps"] - steps >= 20

    run(main())


@repeated_when_delayed
def test_a_viewer_keeps_the_daemon_at_full_rate_without_a_robot(
    serve: Serve, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "REST_AFTER_S", 0.1)
    monkeypatch.setattr(CommandPort, "is_watched", True)

    async def main() -> None:
        async with silent_robot(serve, task) as (running, _, _):
            steps = running.app.status()["steps"]
            await asyncio.sleep(0.6)
            assert running.app.status()["steps"] - steps > 0.5 * 0.6 / CYCLE_S

    run(main())


@repeated_when_delayed
def test_a_robot_that_stands_idle_is_answered_without_steps_until_someone_connects(
    serve: Serve, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "REST_AFTER_S", 0.1)

    async def main() -> None:
        async with serve() as running:
            controller, app = running.controller(task), running.app
            # After the healthy link, 0.1 s of IDLE, and a measured period.
            await controller.cycles(140)
            await controller.answers(140)
            assert app.cycle.is_resting
            steps, wakes = app.cycle.steps, app._timer.lateness.wakes
            await controller.cycles(60)
            await controller.answers(200)
            assert [reply.ipoc for reply in controller.replies] == controller.sent
            assert app.cycle.steps == steps
            assert app._timer.lateness.wakes - wakes < 30
            asked = asyncio.create_task(running.ask("status"))
            await controller.cycles(20)
            status = await asked
            assert 1.5 < status["settles_s"] < 2.0 + CYCLE_S
            assert status["rested"] >= 60
            assert app.cycle.steps > steps + 10
            assert status["replies_lost"] == 0

    run(main())


@repeated_when_delayed
def test_between_the_looks_of_a_rest_the_clock_follows_no_telegram_and_counts_each(
    serve: Serve, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "REST_AFTER_S", 0.1)
    followed: list[int] = []

    async def main() -> None:
        async with serve() as running:
            controller, lock = running.controller(task), running.app._timer.lock
            await controller.cycles(140)
            await controller.answers(140)
            assert running.app.cycle.is_resting
            follow = lock.follow

            def count(stamp_ns: int, cycles: int, **how: Any) -> None:
                followed.append(cycles)
                follow(stamp_ns, cycles, **how)

            followed.clear()
            monkeypatch.setattr(lock, "follow", count)
            await controller.cycles(60)
            await controller.answers(200)
            assert len(followed) < 30
            assert 50 <= sum(followed) + lock.unfollowed <= 65
            assert lock.estimate.measured_ns == pytest.approx(1e9 * CYCLE_S, rel=0.02)

    run(main())


def test_a_daemon_that_someone_is_connected_to_does_not_rest(
    serve: Serve, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(app_module, "REST_AFTER_S", 0.1)
    monkeypatch.setattr(CommandPort, "is_used", True)

    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            await controller.cycles(180)
            assert not running.app.cycle.is_resting
            assert running.app.cycle.rested == 0

    run(main())


@repeated_when_delayed
def test_a_missing_telegram_makes_its_step_and_the_next_one_is_answered(
    serve: Serve, task: Task
) -> None:
    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            await controller.cycles(5)
            for _ in range(3):
                controller.skip()
                await controller.take()
            await controller.cycles(5)
            status = running.app.status()
            assert status["telegrams"]["gap"] >= 1
            assert status["telegrams"]["overdue"] >= 2
            assert status["steps"] >= 13
            await controller.answers(10)

    run(main())


@repeated_when_delayed
def test_garbage_on_every_port_is_counted_and_hurts_no_one(serve: Serve, task: Task) -> None:
    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            await controller.cycles(3)
            for junk in (b"", b"\x00" * 100, b"<!DOCTYPE x>", b"<Rob>" * 300, os.urandom(700)):
                controller.send_bytes(junk)
                with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as anybody:
                    anybody.sendto(junk, tuple(running.listening["camera"]))
                await controller.take()
            await controller.cycles(5)
            status = running.app.status()
            assert status["telegrams"]["unreadable"] >= 4
            assert status["links"]["camera"]["counters"]["refused"] >= 4
            assert status["faults"] == 0
            await controller.answers(8)

    run(main())


@repeated_when_delayed
def test_operators_are_answered_while_telegrams_come_and_while_none_do(
    serve: Serve, task: Task
) -> None:
    async def main() -> None:
        async with serve() as running:
            with pytest.raises(RefusedError, match="the state is INIT"):
                await running.ask("arm")
            controller = running.controller(task)
            exchange = asyncio.create_task(controller.cycles(30))
            listed = (await running.ask("params", {"prefix": "watch."}))["params"]
            assert {one["name"] for one in listed} >= {"watch.healthy_cycles"}
            got = await running.ask("get", {"names": ["watch.healthy_cycles"]})
            assert got["values"] == {"watch.healthy_cycles": 10}
            with pytest.raises(RefusedError, match="configuration file"):
                await running.ask("set", {"values": {"rsi.cycle_ms": 4}})
            changed = await running.ask("set", {"values": {"watch.healthy_cycles": 9}})
            assert changed["changed"] == {"watch.healthy_cycles": {"old": 10, "new": 9}}
            stopped = await running.ask("record", {"action": "stop"})
            assert stopped["file"].endswith(".mcap")
            with pytest.raises(RefusedError, match="nothing is being recorded"):
                await running.ask("record", {"action": "stop"})
            await exchange
            with pytest.raises(RefusedError, match="distance"):
                await running.ask("arm")

    run(main())


def test_a_second_daemon_on_the_same_port_says_so_and_ends(serve: Serve) -> None:
    async def main() -> None:
        async with serve() as running:
            port = running.listening["robot"][1]
            with pytest.raises(StartError, match="robot's port"):
                async with serve(f"task: wheel.yaml\nrsi: {{port: {port}}}\n"):
                    pass

    run(main())


@repeated_when_delayed
def test_a_controller_of_another_cycle_is_answered_and_not_armed_for(
    serve: Serve, task: Task
) -> None:
    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            controller.cycle_s = 0.014
            sending = asyncio.create_task(controller.cycles(10_000))
            reason = "off the 12 ms configured"
            await until(lambda: reason in " ".join(running.app.status()["complaints"]))
            with pytest.raises(RefusedError, match=reason):
                await running.ask("arm")
            sending.cancel()
            assert controller.replies

    run(main())


@repeated_when_delayed
def test_a_fault_in_the_cycle_is_counted_and_the_daemon_goes_on(
    serve: Serve, task: Task, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    caplog.clear()

    def fail(_: object) -> None:
        raise ValueError("planted")

    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            await controller.cycles(3)
            with monkeypatch.context() as planted:
                planted.setattr(
                    running.app.cycle,
                    "_reply",
                    lambda _: (_ for _ in ()).throw(ValueError("planted")),
                )
                await controller.cycles(3)
            await controller.cycles(3)
            status = await running.ask("status")
            # A step made before its telegram may fail as well, and is made again in line.
            assert 3 <= status["faults"] <= 6
            assert "faults in the cycle" in " ".join(status["complaints"])
            await controller.answers(6)
        assert caplog.text.count("fault 1 in the cycle") == 1
        assert "fault 2" not in caplog.text

    run(main())


def test_sigterm_ends_and_sighup_reloads_and_systemd_hears_of_both(
    serve: Serve, tmp_path: Path
) -> None:
    async def main() -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
            manager.bind(str(tmp_path / "notify"))
            manager.settimeout(5.0)
            notifier = Notifier(str(tmp_path / "notify"), watchdog_s=0.03)
            async with serve(notifier=notifier) as running:
                heard: list[bytes] = []

                def listen() -> None:
                    while not heard or b"STOPPING=1" not in heard[-1]:
                        heard.append(manager.recv(300))

                listener = threading.Thread(target=listen)
                listener.start()
                await until(lambda: heard.count(b"WATCHDOG=1") >= 2)
                os.kill(os.getpid(), signal.SIGHUP)
                await until(lambda: any(b"RELOADING=1" in one for one in heard))
                os.kill(os.getpid(), signal.SIGTERM)
                await asyncio.to_thread(listener.join)
                assert heard[0].startswith(b"READY=1\nSTATUS=INIT")
                assert running.app.cycle.steps == 0

    run(main())


def test_a_daemon_that_fails_at_every_telegram_is_not_called_alive(
    serve: Serve, tmp_path: Path, task: Task, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: object) -> None:
        raise ValueError("planted")

    async def main() -> None:
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as manager:
            manager.bind(str(tmp_path / "notify"))
            manager.setblocking(False)
            notifier = Notifier(str(tmp_path / "notify"), watchdog_s=0.03)

            def fed() -> int:
                heard = []
                with contextlib.suppress(BlockingIOError):
                    while True:
                        heard.append(manager.recv(300))
                return heard.count(b"WATCHDOG=1")

            async with serve(notifier=notifier) as running:
                controller = running.controller(task)
                await controller.cycles(10)
                assert fed() >= 2
                with monkeypatch.context() as planted:
                    planted.setattr(running.app.cycle, "_reply", fail)
                    await controller.cycles(1)
                    fed()
                    # Shorter than what makes the link a lost one, which is no fault of ours.
                    for _ in range(6):
                        controller.skip()
                        await controller.take()
                        await controller.cycles(1)
                    assert fed() == 0
                await controller.cycles(10)
                assert fed() >= 2

    run(main())


def test_a_foreign_peer_is_not_answered_where_one_is_named(serve: Serve, task: Task) -> None:
    async def main() -> None:
        text = CONFIG.replace("{port: 0}\ncamera", "{port: 0, peer: 127.0.0.9}\ncamera")
        async with serve(text) as running:
            controller = running.controller(task)
            await controller.cycles(3)
            assert controller.replies == []
            assert running.app.counters["foreign_telegrams"] == 3

    run(main())


def test_an_end_while_the_robot_moves_brings_it_to_rest_first(serve: Serve, task: Task) -> None:
    from linemate.daemon.cycle.states import Machine, State

    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            await controller.cycles(15)
            running.app.cycle.operating.machine = Machine(State.TRACK)
            running.app.end()
            with contextlib.suppress(ConnectionRefusedError):  # it has ended
                await controller.cycles(50)
            assert running.app.cycle.machine.state is State.HOLD
            assert len(controller.replies) < 50

    run(main())


@pytest.mark.parametrize("fails", [False, True])
def test_a_telegram_that_was_attended_is_followed_up_without_a_turn_of_the_loop(
    *, fails: bool
) -> None:
    done: list[str] = []

    def attend(_: int) -> None:
        app._call_after_reply(station)
        done.append("sent")
        if fails:
            raise OSError

    app: Any = App
    station: Any = SimpleNamespace(
        cycle=SimpleNamespace(ready_reply=object()),
        _timer=SimpleNamespace(lock=SimpleNamespace(period_ns=4_000_000)),
        _robot=SimpleNamespace(attend=attend),
        _after=lambda: done.append("after"),
        _after_waits=False,
        _is_attending=False,
    )
    with contextlib.suppress(OSError):
        app._attend(station, 0)
    assert done == (["sent"] if fails else ["sent", "after"])
    assert not station._is_attending


@pytest.mark.parametrize(
    ("since_s", "left_ms", "locked", "due"),
    [
        (0.9, 500.0, True, False),
        (1.1, 500.0, True, True),
        (1.1, 0.0, True, False),
        (1.1, 0.0, False, True),
        (2.0, 0.0, True, True),
    ],
)
def test_what_is_done_once_a_second_waits_for_a_cycle_with_time(
    *, since_s: float, left_ms: float, locked: bool, due: bool
) -> None:
    now_ns, app = time.monotonic_ns(), App
    lock = SimpleNamespace(
        is_locked=locked, lead_ns=2_000_000, next_ns=now_ns + 2_000_000 + round(1e6 * left_ms)
    )
    station: Any = SimpleNamespace(
        _status_ns=now_ns - round(1e9 * since_s), _timer=SimpleNamespace(lock=lock)
    )
    assert app._is_status_due(station, now_ns) is due


def test_poses_are_handed_in_over_the_socket_and_followed_until_a_stop(
    serve: Serve, task: Task
) -> None:
    async def main() -> None:
        async with serve() as running:
            controller = running.controller(task)
            exchange = asyncio.create_task(controller.cycles(150))
            await until(lambda: running.app.cycle.machine.state is State.IDLE, 5.0)
            await until(lambda: running.app.cycle.refusal("follow") is None, 5.0)
            now_ns = (await running.ask("follow", {"begin_ns": 0, "poses": []}))["now_ns"]
            assert abs(now_ns - time.monotonic_ns()) < 5e9
            last = running.app.cycle.last
            assert last is not None
            pose = [*last.outputs.target]
            rows = [[0.1 * i, *pose] for i in range(5)]
            away = [[row[0], row[1] + 0.05, *row[2:]] for row in rows]
            with pytest.raises(RefusedError, match=r"first pose is 50\.0 mm"):
                await running.ask("follow", {"begin_ns": now_ns + 10**8, "poses": away})
            with pytest.raises(RefusedError, match=r"beyond 60 s"):
                await running.ask("follow", {"begin_ns": now_ns, "poses": [[1e300, *pose]]})
            params = {"begin_ns": now_ns + 10**8, "poses": rows}
            assert (await running.ask("follow", params))["state"] == "follow"
            assert (await running.ask("follow", params))["state"] == "follow"
            assert (await running.ask("stop"))["state"] == "idle"
            await exchange

    run(main())
