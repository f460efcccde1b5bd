"""A daemon that serves in the loop of a test, and the controllers that ask it."""

import asyncio
import contextlib
import functools
import socket
import time
from collections.abc import AsyncIterator, Callable
from pathlib import Path
from typing import Any

from loops import until

from linemate.daemon.config import config
from linemate.daemon.config.files import PROTOCOL_DATA
from linemate.daemon.config.task_file import Task
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.service.app import App
from linemate.daemon.service.host import realtime
from linemate.daemon.service.host.notify import Notifier
from linemate.daemon.transport.client import Client
from linemate.protocol.rsi.codec import RobotTelegram, RsiCodec, SensorTelegram
from linemate.protocol.rsi.ethernet_config import parse_config

CYCLE_S = 0.012
CONFIG = """
task: wheel.yaml
rsi: {port: 0}
camera: {port: 0}
command: {socket: c.sock}
recording: {directory: ., at_start: true}
realtime: {freeze_collector: false, lead_ms: 0}
watch: {healthy_cycles: 10}
"""


DELAYED_S = CYCLE_S / 3.0
ATTEMPTS = 6
late_s: list[float] = []
"""How late the controllers of a test woke; the daemon in the same loop was as late."""


def repeated_when_delayed(test: Callable[..., None]) -> Callable[..., None]:
    """What a daemon does in time is to be seen while its machine lets it: the last try counts."""

    @functools.wraps(test)
    def attempts(*args: Any, **fixtures: Any) -> None:
        for _ in range(ATTEMPTS - 1):
            late_s.clear()
            try:
                return test(*args, **fixtures)
            except AssertionError:
                if max(late_s, default=0.0) < DELAYED_S:
                    raise
        return test(*args, **fixtures)

    return attempts


SHIPPED = PROTOCOL_DATA / "rsi_joints.xml"


class Controller:
    """A controller that sends a telegram each cycle and keeps every reply."""

    def __init__(self, target: tuple[str, int], rest: tuple[float, ...]) -> None:
        self.codec = RsiCodec(parse_config(SHIPPED.read_bytes()))
        self.replies: list[SensorTelegram] = []
        self.sent: list[int] = []
        self._rest = rest
        self._ipoc = 4_000_000
        self._skipped = 0
        self.cycle_s = CYCLE_S
        self._next_s = time.monotonic()
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.setblocking(False)
        self._socket.connect(target)

    def send(self) -> None:
        self._ipoc += 12
        telegram = RobotTelegram(
            self._ipoc,
            joints=self._rest,  # type: ignore[arg-type]
            external=(0.0,) * 6,
            tcp=(0.0,) * 6,
            delay=self._skipped + len(self.sent) - len(self.replies),
            channels={"DiL": 0},
        )
        self.sent.append(self._ipoc)
        self._socket.send(self.codec.format_robot(telegram))

    def send_bytes(self, data: bytes) -> None:
        self._socket.send(data)

    def skip(self) -> None:
        """A cycle whose telegram is lost on its way."""
        self._ipoc += 12
        self._skipped += 1

    async def take(self) -> None:
        # After a stall the pace begins again: no burst of telegrams for the lost time.
        due_s = self._next_s + self.cycle_s
        self._next_s = max(due_s, time.monotonic())
        await asyncio.sleep(self._next_s - time.monotonic())
        late_s.append(time.monotonic() - due_s)
        self._receive()

    async def answers(self, count: int) -> None:
        """Waits for the answers that have not come yet; not one more than count may come."""

        def all_here() -> bool:
            self._receive()
            return len(self.replies) >= count

        await until(all_here, 2.0)
        assert len(self.replies) == count

    def _receive(self) -> None:
        with contextlib.suppress(BlockingIOError):
            while True:
                self.replies.append(self.codec.parse_sensor(self._socket.recv(2048)))

    async def cycles(self, count: int) -> None:
        if not self.sent:
            # The daemon has to hear that no program runs before one starts.
            await asyncio.sleep(0.1)
            self._next_s = time.monotonic()
        for _ in range(count):
            self.send()
            await self.take()

    def close(self) -> None:
        self._socket.close()


class Running:
    """A daemon that serves in this loop."""

    def __init__(self, app: App, listening: dict[str, Any], folder: Path) -> None:
        self.app = app
        self.listening = listening
        self.folder = folder
        self.controllers: list[Controller] = []

    def controller(self, task: Task) -> Controller:
        """A controller that sends here; closed with the daemon."""
        target = tuple(self.listening["robot"])
        self.controllers.append(Controller(target, task.file.arm.rest_joints))
        return self.controllers[-1]

    async def ask(self, op: str, params: dict[str, Any] | None = None) -> dict[str, Any]:
        def call() -> dict[str, Any]:
            with Client.local(self.folder / "c.sock") as client:
                return client.call(op, params, 5.0)

        return await asyncio.to_thread(call)


def _forget_recordings(folder: Path) -> None:
    """Those of an attempt before."""
    for recording in folder.glob("*.mcap"):
        recording.unlink()


Serve = Callable[..., contextlib.AbstractAsyncContextManager[Running]]


def serve_in(folder: Path, parameters: Parameters) -> Serve:
    """Return what starts the daemon of a folder."""

    @contextlib.asynccontextmanager
    async def serve(text: str = CONFIG, notifier: Notifier | None = None) -> AsyncIterator[Running]:
        await asyncio.to_thread(_forget_recordings, folder)
        path = folder / "linemated.yaml"
        path.write_text(text)
        station = config.load(path)
        app = App(
            station,
            parameters,
            realtime.request_all(station.config.realtime),
            notifier or Notifier(),
        )
        ready: asyncio.Future[dict[str, Any]] = asyncio.get_running_loop().create_future()
        serving = asyncio.create_task(app.run(ready.set_result))
        either: list[asyncio.Future[Any]] = [serving, ready]
        await asyncio.wait(either, return_when=asyncio.FIRST_COMPLETED)
        if serving.done():
            serving.result()
        running = Running(app, ready.result(), folder)
        try:
            yield running
        finally:
            app.end()
            await serving
            for controller in running.controllers:
                controller.close()

    return serve
