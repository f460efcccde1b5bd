"""A PLC and the daemon's OPC UA server, in a process of their own next to a shift in virtual time.

The PLC is asyncua's client, on loopback. The server is that of ``linemate plc``; its requests to
the daemon go through a pipe to the process that has the daemon.

Invariants:
- The PLC calls methods and reads variables of the server, and has nothing else.
- Variables are those of the daemon's status at the time of the reading.
"""

import asyncio
import logging
import os
import secrets
from collections.abc import Mapping
from multiprocessing.connection import Connection
from socket import socket
from typing import Any, Final

from asyncua import Client

from linemate.daemon.operator.plc import plc_server, plc_users
from linemate.daemon.operator.plc.plc_server import PlcServer
from linemate.daemon.transport.client import NoAnswerError, RefusedError
from linemate.protocol.command.frame_codec import Role
from linemate.simulators.harness.processes import die_with

USER: Final = "line"
READ: Final = ("Connected", "State", "Held", "Fault")


class PipeClient:
    """Stands for the client of the command protocol that ``linemate plc`` has."""

    def __init__(self, pipe: Connection) -> None:
        """Keep the pipe to the daemon's process."""
        self._pipe = pipe

    def call(self, op: str, params: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
        """Return the daemon's answer.

        Raises:
            RefusedError, NoAnswerError: as the client of the command protocol.
        """
        del timeout_s  # the daemon's process answers or has ended
        try:
            self._pipe.send((op, dict(params)))
            result, why = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise NoAnswerError(str(error)) from error
        if result is None:
            raise RefusedError("refused", why)
        return dict(result)

    def close(self) -> None:
        """End the connection."""
        self._pipe.close()


def main(orders: Connection, requests: Connection, parent: int) -> None:
    """Serve and be the PLC until ``orders`` is closed.

    Args:
        orders: of the line: a method with its arguments, or None for the variables.
        requests: operation and arguments for the daemon; its result, or None and the reason.
        parent: process without which this one ends.
    """
    die_with(parent)
    logging.getLogger("asyncua").setLevel(logging.ERROR)  # no encryption within this process
    asyncio.run(_serve(orders, requests))


async def _serve(orders: Connection, requests: Connection) -> None:
    password, salt = secrets.token_hex(16), os.urandom(plc_users.SALT_BYTES)
    user = plc_users.parse_line(plc_users.user_line(USER, Role.OPERATE, password, salt))
    assert user is not None  # noqa: S101 - it is made in the line before
    endpoint = f"opc.tcp://127.0.0.1:{_free_port()}/linemate"
    server = PlcServer(endpoint, {USER: user}, lambda: PipeClient(requests), poll_s=None)
    end, is_open = asyncio.Event(), asyncio.Event()
    serving = asyncio.create_task(server.run(end, is_open.set))
    await is_open.wait()
    client = Client(endpoint)
    client.set_user(USER)
    client.set_password(password)
    async with client:
        index = await client.get_namespace_index(plc_server.NAMESPACE)
        station = await client.nodes.objects.get_child(f"{index}:Station")
        shown = [await station.get_child(f"{index}:{name}") for name in READ]
        while (order := await asyncio.to_thread(_next, orders)) is not None:
            method, arguments = order
            if method is None:
                await server.refresh()
                values = await client.read_values(shown)
                orders.send(dict(zip(READ, values, strict=True)))
            else:
                orders.send(tuple(await station.call_method(f"{index}:{method}", *arguments)))
    end.set()
    await serving


def _next(orders: Connection) -> tuple[str | None, tuple[Any, ...]] | None:
    """Return the next order, None at the end."""
    try:
        order: tuple[str | None, tuple[Any, ...]] = orders.recv()
    except (EOFError, OSError):
        return None
    return order


def _free_port() -> int:
    with socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])
