"""The OPC UA server as a PLC sees it: asyncua's client against the server's own process."""

import asyncio
import math
import subprocess
import sys
from collections.abc import AsyncIterator, Callable, Coroutine, Iterator
from contextlib import asynccontextmanager
from pathlib import Path
from socket import socket
from typing import Any

import pytest
from asyncua import Client, ua
from daemon_process import LINEMATE, DaemonProcess

from linemate.daemon.operator.plc import plc_users
from linemate.protocol.command.frame_codec import Role

pytestmark = pytest.mark.filterwarnings("ignore::DeprecationWarning:asyncua.*")

SALT = bytes(range(16))
PASSWORD = "correct horse"
STATION = """
task: wheel.yaml
rsi: {port: 0}
command: {socket: command.sock}
production: {variants: {sedan: wheel.yaml}, announced_at: -3.0, records: .}
"""


@pytest.fixture(scope="module")
def endpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[str]:
    """About 4 s: a daemon without a robot, and the server in a process of its own."""
    folder = tmp_path_factory.mktemp("plc")
    users = folder / "users"
    lines = [plc_users.user_line(f"{role}r", role, PASSWORD, SALT) for role in Role]
    users.write_text("\n".join(lines))
    users.chmod(0o600)
    with socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = str(probe.getsockname()[1])
    words = ["plc", "--users", str(users), "--port", port]
    words += ["--socket", str(folder / "command.sock")]
    with DaemonProcess(folder, STATION):
        server = subprocess.Popen([*LINEMATE, *words], stdout=subprocess.PIPE, text=True)
        try:
            assert server.stdout is not None
            yield server.stdout.readline().strip()
        finally:
            server.terminate()
            assert server.wait(10.0) == 0
            server.stdout.close()


@asynccontextmanager
async def session(endpoint: str, user: str, password: str = PASSWORD) -> AsyncIterator[Any]:
    """The node of the station, seen by a user."""
    client = Client(endpoint)
    client.set_user(user)
    client.set_password(password)
    async with client:
        index = await client.get_namespace_index("urn:linemate:station")
        yield await client.nodes.objects.get_child(f"{index}:Station")


async def read(station: Any, name: str) -> Any:
    return await (await station.get_child(f"{station.nodeid.NamespaceIndex}:{name}")).read_value()


async def call(station: Any, name: str, *arguments: Any) -> tuple[bool, str]:
    ok, why = await station.call_method(f"{station.nodeid.NamespaceIndex}:{name}", *arguments)
    return ok, why


async def until(condition: Callable[[], Coroutine[Any, Any, bool]]) -> None:
    for _ in range(100):
        if await condition():
            return
        await asyncio.sleep(0.05)
    raise AssertionError("the value never came")


def test_a_plc_announces_starts_and_reads_the_results(endpoint: str) -> None:
    async def body() -> None:
        async with session(endpoint, "operater") as station:
            await until(lambda: read(station, "Connected"))
            assert await read(station, "State") == "init"
            assert await read(station, "Held") == "start of the daemon"
            assert not await read(station, "InSync")
            assert await call(station, "Announce", "P1", "sedan", 5.0) == (True, "")
            assert await call(station, "Announce", "P2", "sedan", 6.0) == (True, "")

            async def waits() -> bool:
                return bool(await read(station, "Waiting") == 2)

            await until(waits)
            assert await call(station, "Skip", "P1") == (True, "")

            async def skipped() -> bool:
                return bool(await read(station, "PartOut") == "P1")

            await until(skipped)
            assert await read(station, "ResultReason") == "skipped by order"
            assert not await read(station, "ResultOk")
            assert await read(station, "Bad") == 1
            assert await call(station, "Start") == (True, "")

            async def runs() -> bool:
                return bool(await read(station, "Held") == "")

            await until(runs)
            assert await call(station, "Hold") == (True, "")

    asyncio.run(body())


def test_the_names_of_opc_40010_lead_to_task_and_axes(endpoint: str) -> None:
    async def body() -> None:
        async with session(endpoint, "viewr") as station:
            client = Client(endpoint)
            client.set_user("viewr")
            client.set_password(PASSWORD)
            async with client:
                own = station.nodeid.NamespaceIndex
                di = await client.get_namespace_index("http://opcfoundation.org/UA/DI/")
                names = await client.get_namespace_index("http://opcfoundation.org/UA/Robotics/")
                root = [f"{di}:DeviceSet", f"{own}:linemate"]

                async def value(*path: str) -> Any:
                    node = await client.nodes.objects.get_child([*root, *path])
                    return await node.read_value()

                task = [f"{names}:Controllers", f"{own}:Daemon", f"{names}:TaskControls"]
                task += [f"{own}:Task", f"{di}:ParameterSet"]
                await until(lambda: read(station, "Connected"))
                assert await value(*task, f"{names}:TaskProgramName") == "wheel"
                assert await value(*task, f"{names}:TaskProgramLoaded") is True
                assert await value(*task, f"{names}:ExecutionMode") == 1
                robot = [f"{names}:MotionDevices", f"{own}:Robot"]
                # No robot has sent a telegram.
                assert await value(*robot, f"{di}:ParameterSet", f"{names}:OnPath") is False
                axis = [*robot, f"{names}:Axes", f"{own}:A1", f"{di}:ParameterSet"]
                assert math.isnan(await value(*axis, f"{names}:ActualPosition"))
                unit = await value(*axis, f"{names}:ActualPosition", "0:EngineeringUnits")
                assert unit.DisplayName.Text == "rad"
                assert await client.nodes.objects.get_child([*root, f"{names}:SafetyStates"])

    asyncio.run(body())


def test_a_refusal_of_the_daemon_comes_as_its_reason(endpoint: str) -> None:
    async def body() -> None:
        async with session(endpoint, "operater") as station:
            ok, why = await call(station, "Announce", "P9", "tractor", 7.0)
            assert not ok
            assert "variant 'tractor' is not known" in why
            ok, why = await call(station, "Ack")
            assert (ok, "ack needs FAULT" in why) == (False, True)

    asyncio.run(body())


def test_a_user_who_may_view_reads_and_neither_calls_nor_writes(endpoint: str) -> None:
    async def body() -> None:
        async with session(endpoint, "viewr") as station:
            assert isinstance(await read(station, "State"), str)
            with pytest.raises(ua.UaError):
                await call(station, "Start")
            index = station.nodeid.NamespaceIndex
            state = await station.get_child(f"{index}:State")
            with pytest.raises(ua.UaError):
                await state.write_value("track")

    asyncio.run(body())


def test_an_operator_writes_no_value_either(endpoint: str) -> None:
    async def body() -> None:
        async with session(endpoint, "operater") as station:
            fault = await station.get_child(f"{station.nodeid.NamespaceIndex}:Fault")
            with pytest.raises(ua.UaError):
                await fault.write_value(True)

    asyncio.run(body())


@pytest.mark.parametrize(
    ("user", "password"), [("operater", "wrong horse"), ("stranger", PASSWORD), ("", "")]
)
def test_a_session_without_the_right_password_is_refused(
    endpoint: str, user: str, password: str
) -> None:
    async def body() -> None:
        client = Client(endpoint)
        if user:
            client.set_user(user)
            client.set_password(password)
        with pytest.raises(ua.UaError):
            async with client:
                pass

    asyncio.run(body())


def test_another_address_needs_consent_and_a_certificate(tmp_path: Path) -> None:
    words = ["plc", "--users", str(tmp_path / "users"), "--bind", "0.0.0.0"]
    done = subprocess.run([*LINEMATE, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 2
    assert "--allow-remote and give --certificate" in done.stderr


def test_the_line_of_a_user_is_made_from_standard_input() -> None:
    words = [sys.executable, "-m", "linemate.daemon.operator.main", "plc-user", "hmi", "view"]
    done = subprocess.run(words, input="long enough\n", capture_output=True, text=True, check=True)
    name, role, salt, digest = done.stdout.split()
    assert (name, role, len(salt), len(digest)) == ("hmi", "view", 32, 64)
