"""OPC UA server of one daemon: variables from its status, methods to its operations.

Invariants:
- No anonymous session. A user with the role view reads; only the role operate calls methods.
- No variable can be written from outside.
- A daemon that does not answer is shown as not connected; the server goes on.
"""

import asyncio
import contextlib
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, Final, Protocol

from asyncua import Server, ua
from asyncua.crypto.permission_rules import SimpleRoleRuleset, User, UserRole
from asyncua.server.user_managers import UserManager

from linemate.daemon.operator.plc import plc_users
from linemate.daemon.operator.plc.plc_users import PlcUser
from linemate.daemon.operator.plc.plc_values import PlcValues, values_of
from linemate.daemon.operator.plc.robotics_nodes import RoboticsNodes
from linemate.daemon.operator.plc.robotics_values import robotics_values
from linemate.daemon.transport.client import NoAnswerError, RefusedError
from linemate.protocol.command.frame_codec import CommandError, Role

NAMESPACE: Final = "urn:linemate:station"
POLL_S: Final = 0.1
ASK_S: Final = 1.0
METHODS: Final[Mapping[str, tuple[str, tuple[tuple[str, ua.VariantType], ...]]]] = {
    "Start": ("next", ()),
    "Stop": ("stop", ()),
    "Hold": ("hold", ()),
    "Ack": ("ack", ()),
    "Skip": ("skip", (("part", ua.VariantType.String),)),
    "Announce": (
        "announce",
        (
            ("part", ua.VariantType.String),
            ("variant", ua.VariantType.String),
            ("distance", ua.VariantType.Double),
        ),
    ),
}
"""Operation and arguments of each method."""

_TYPES: Final = {
    bool: ua.VariantType.Boolean,
    int: ua.VariantType.UInt32,
    str: ua.VariantType.String,
}
_FAILURES: Final = (NoAnswerError, RefusedError, CommandError, OSError)
_CALL: Final = ua.NodeId(ua.ObjectIds.CallRequest_Encoding_DefaultBinary)
_WRITE: Final = ua.NodeId(ua.ObjectIds.WriteRequest_Encoding_DefaultBinary)


class DaemonClient(Protocol):
    """What the server needs of a client of the daemon; ``transport.client`` has one."""

    def call(self, op: str, params: Mapping[str, Any], timeout_s: float) -> dict[str, Any]:
        """Return the daemon's answer, or raise ``RefusedError`` or ``NoAnswerError``."""
        ...

    def close(self) -> None:
        """End the connection."""
        ...


class PlcUserManager(UserManager):  # type: ignore[misc]
    """Maps a name and a password to a role: operate is asyncua's admin, view its user."""

    def __init__(self, users: Mapping[str, PlcUser]) -> None:
        self._users = users

    def get_user(
        self,
        iserver: Any,
        username: str | None = None,
        password: str | None = None,
        certificate: Any = None,
    ) -> User | None:
        """Return the user of a session, None to refuse it."""
        del iserver, certificate
        if not username or password is None:
            return None
        role = plc_users.role_of(self._users, username, password)
        if role is None:
            return None
        return User(UserRole.Admin if role is Role.OPERATE else UserRole.User, username)


class PlcRuleset(SimpleRoleRuleset):  # type: ignore[misc]
    """Requests by role: no one changes a node or writes a value, operate alone calls methods."""

    def __init__(self) -> None:
        """Take asyncua's requests of its user, without writing and calling."""
        super().__init__()
        known: dict[UserRole, set[Any]] = self._permission_dict
        asked = known[UserRole.User] - {_WRITE, _CALL}
        self._permission_dict: dict[UserRole, set[Any]] = {
            UserRole.Admin: asked | {_CALL},
            UserRole.User: asked,
            UserRole.Anonymous: set(),
        }


class PlcServer:
    """The server that runs.

    Attributes:
        values: as last written to the variables.
    """

    def __init__(
        self,
        endpoint: str,
        users: Mapping[str, PlcUser],
        connect: Callable[[], DaemonClient],
        poll_s: float | None = POLL_S,
    ):
        """Prepare the server; ``run`` opens the port.

        Args:
            endpoint: URL to serve at, such as ``opc.tcp://127.0.0.1:4840/linemate``.
            connect: returns a client of the daemon.
            poll_s: period at which the status is read [s]; None: only ``refresh`` reads it.
        """
        self._poll_s = poll_s
        self.values = PlcValues()
        self._endpoint, self._users, self._connect = endpoint, users, connect
        self._client: DaemonClient | None = None
        self._lock = asyncio.Lock()
        self._nodes: dict[str, Any] = {}
        self._robotics = RoboticsNodes()

    async def run(
        self,
        end: asyncio.Event,
        on_ready: Callable[[], None] = lambda: None,
        certificate: tuple[Path, Path] | None = None,
    ) -> None:
        """Serve until the end.

        Args:
            on_ready: called once the port is open.
            certificate: of the server, and its private key. With one, sessions are encrypted.

        Raises:
            OSError: the port or a file cannot be opened.
        """
        server = Server(user_manager=PlcUserManager(self._users))
        await server.init()
        server.set_endpoint(self._endpoint)
        server.set_server_name("linemate")
        server.set_identity_tokens([ua.UserNameIdentityToken])
        policy = ua.SecurityPolicyType.NoSecurity
        if certificate is not None:
            await server.load_certificate(str(certificate[0]))
            await server.load_private_key(str(certificate[1]))
            policy = ua.SecurityPolicyType.Basic256Sha256_SignAndEncrypt
        server.set_security_policy([policy], permission_ruleset=PlcRuleset())
        await self._make_nodes(server)
        async with server:
            on_ready()
            while self._poll_s is not None and not end.is_set():
                await self.refresh()
                with contextlib.suppress(TimeoutError):
                    await asyncio.wait_for(end.wait(), self._poll_s)
            await end.wait()
        if self._client is not None:
            self._client.close()

    async def _make_nodes(self, server: Server) -> None:
        """Make the object with its variables and methods."""
        index = await server.register_namespace(NAMESPACE)
        station = await server.nodes.objects.add_object(index, "Station")
        for name, value in self.values._asdict().items():
            kind = _TYPES[type(value)]
            node_id = ua.NodeId(f"Station.{name}", index)
            self._nodes[name] = await station.add_variable(node_id, f"{index}:{name}", value, kind)
        for name, (op, arguments) in METHODS.items():
            await station.add_method(
                ua.NodeId(f"Station.{name}", index),
                f"{index}:{name}",
                self._method(op, tuple(argument for argument, _ in arguments)),
                [_argument(*argument) for argument in arguments],
                [_argument("ok", ua.VariantType.Boolean), _argument("why", ua.VariantType.String)],
            )
        await self._robotics.make(server, index)

    def _method(self, op: str, names: tuple[str, ...]) -> Callable[..., Any]:
        """Return what asyncua calls for a method: it returns whether it was done, and why not."""

        async def call(_parent: ua.NodeId, *given: ua.Variant) -> list[ua.Variant]:
            values = dict(zip(names, (variant.Value for variant in given), strict=False))
            # An empty part is the next one, a distance that is no number the newest reading.
            params = {n: v for n, v in values.items() if v not in ("", None) and v == v}  # noqa: PLR0124
            why = await self._order(op, params)
            return [
                ua.Variant(why is None, ua.VariantType.Boolean),
                ua.Variant(why or "", ua.VariantType.String),
            ]

        return call

    async def _order(self, op: str, params: Mapping[str, Any]) -> str | None:
        """Give an order to the daemon; return why it was not done, or None."""
        try:
            await self._ask(op, params)
        except RefusedError as error:
            return str(error)
        except _FAILURES as error:
            return f"no answer from the daemon: {error}"
        return None

    async def _ask(self, op: str, params: Mapping[str, Any]) -> dict[str, Any]:
        """Return the daemon's answer; one request at a time, in a thread."""
        async with self._lock:
            return await asyncio.to_thread(self._call, op, params)

    def _call(self, op: str, params: Mapping[str, Any]) -> dict[str, Any]:
        if self._client is None:
            self._client = self._connect()
        return self._client.call(op, params, ASK_S)

    async def refresh(self) -> None:
        """Read the status and write what has changed since the last one."""
        try:
            status: dict[str, Any] | None = await self._ask("status", {})
        except _FAILURES:
            status = None
        values = values_of(status)
        for name, value in values._asdict().items():
            if value != getattr(self.values, name):
                await self._nodes[name].write_value(ua.Variant(value, _TYPES[type(value)]))
        self.values = values
        await self._robotics.write(robotics_values(status))


def _argument(name: str, kind: ua.VariantType) -> ua.Argument:
    argument = ua.Argument()
    argument.Name = name
    argument.DataType = ua.NodeId(kind.value)
    argument.ValueRank = -1
    return argument
