"""Files that a configuration names: task, URDF, controller file, DBC and keys.

Invariants:
- Plain values are read, so that the errors of all files come together with the file's own.
"""

from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

from linemate.daemon.config import controller_section, files, section_checks, task_file, timeouts
from linemate.daemon.config.controller_section import ControllerFile
from linemate.daemon.config.documents import FileError
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.config.key_file import key_path, read_keys
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.section_checks import PlainValues
from linemate.daemon.config.task_file import Task
from linemate.protocol.command.preshared_keys import PresharedKey
from linemate.protocol.errors import ProtocolError
from linemate.protocol.sensors.distance import DistanceDecoder, message_names

MAX_LINK_BYTES = 1_048_576


class NamedFiles:
    """The files that a configuration names, and what is wrong with them.

    Attributes:
        task, controller, dbc, keys: contents, None or empty where a file is absent or wrong.
        texts: files for recordings, by name: task, urdf, dbc, and the controller's family.
        variants: tasks of the production's variants, by name.
        lines: errors of the task files, as ``file:line:col: key: what``.
    """

    def __init__(self, base: Path, value: Any) -> None:
        self.task: Task | None = None
        self.controller: ControllerFile | None = None
        self.dbc: str | None = None
        self.keys: tuple[PresharedKey, ...] = ()
        self.texts: dict[str, str] = {}
        self.variants: dict[str, Task] = {}
        self.lines: list[str] = []
        self._decoder: tuple[str, str, str] | None = None
        self._base = base
        self._values = PlainValues(value)
        self._kind = controller_section.kind_of(self._values)

    def complaints(self, _: Any) -> Iterator[Complaint]:
        """Read all files and check them against the configuration."""
        for path, read in (
            (("task",), self._read_task),
            ((self._kind, "config"), self._read_controller),
            (("distance", "dbc"), self._read_dbc),
            (("distance", "message"), self._check_message),
            (("distance", "strength"), self._check_strength),
            (("command", "udp", "keys"), self._read_keys),
        ):
            yield from self._attempt(path, read)
        yield from self._variant_complaints()
        task = None if self.task is None else self.task.file
        yield from controller_section.complaints(self._kind, self._values, self.controller, task)
        port = controller_section.default_port(self._kind, self.controller)
        yield from section_checks.complaints(self._values, self._base, (self._kind, port))
        yield from timeouts.complaints(self._values.value)

    def _attempt(self, path: tuple[str, ...], read: Callable[[], None]) -> Iterator[Complaint]:
        try:
            read()
        except FileError as error:
            self.lines.extend(error.lines)
        except (UnreadableError, ProtocolError, ValueError) as error:
            for what in str(error).splitlines():  # a key file has one for each bad line
                yield Complaint(path, what)

    def _read_task(self) -> None:
        name = self._values.get("task", kind=str)
        if name:
            self.task = task_file.load(files.find(name, self._base, files.DAEMON_DATA))
            self.texts |= {"task": self.task.text, "urdf": self.task.urdf}

    def _variant_complaints(self) -> Iterator[Complaint]:
        """Read the variants' tasks, and yield what is wrong with them."""
        names: dict[Any, Any] = self._values.get("production", "variants", kind=dict) or {}
        for variant, name in names.items():
            if isinstance(variant, str) and isinstance(name, str) and name:
                path = ("production", "variants", variant)
                yield from self._attempt(path, partial(self._read_variant, variant, name))

    def _read_variant(self, variant: str, name: str) -> None:
        task = task_file.load(files.find(name, self._base, files.DAEMON_DATA))
        if self.task is not None and task.file.arm != self.task.file.arm:
            raise ValueError(f"{name}: its arm differs from that of the configured task")
        self.variants[variant] = task

    def _read_controller(self) -> None:
        content = controller_section.read_file(self._kind, self._values, self._base)
        if content is not None:
            self.controller, self.texts[self._kind.value] = content

    def _read_dbc(self) -> None:
        if not self._values.has("distance"):
            return
        get = self._values.get
        name = get("distance", "dbc", kind=str, default="distance.dbc")
        message = get("distance", "message", kind=str, default="CIA406_TPDO1")
        signal = get("distance", "signal", kind=str, default="Position")
        if name and message and signal:
            path = files.find(name, self._base, files.PROTOCOL_DATA)
            text = files.read_text(path, MAX_LINK_BYTES)
            if "\n" not in text:  # which the decoder takes for the name of a file
                raise ValueError("not a DBC: a single line")
            message_names(text)
            self.dbc = self.texts["dbc"] = text
            self._decoder = (text, message, signal)

    def _check_message(self) -> None:
        if self._decoder is not None:
            decoder, self._decoder = self._decoder, None
            DistanceDecoder(*decoder)
            self._decoder = decoder

    def _check_strength(self) -> None:
        strength = self._values.get("distance", "strength", kind=str)
        if self._decoder is not None and strength:
            DistanceDecoder(*self._decoder, strength=strength)

    def _read_keys(self) -> None:
        name = self._values.get("command", "udp", "keys", kind=str)
        if name:
            self.keys = read_keys(key_path(name, self._base))
            if not self.keys:
                raise ValueError("holds no key. Make one with `linemate keygen`.")
