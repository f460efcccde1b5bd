"""Where operators' parameters are judged, taken between two steps, and kept.

Law of this file: all of a change or none of it, as one new frozen set. What changes live is made
within a reply's slack; what needs a compiler is made in a thread and taken only if the robot still
stands; files are written in a thread. A refusal says which parameter and why.
"""

import asyncio
import logging
import math
import time
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from msgspec.structs import replace

from linemate.daemon.config import overlays, parameter_list
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.config import LoadedConfig
from linemate.daemon.config.parameter_list import ChangeTime, Parameter
from linemate.daemon.config.settings_tree import SettingError, Settings
from linemate.daemon.config.watch_settings import timeout_error
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core import step as stepping
from linemate.daemon.core.control import urdf_limits
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.states import State

T = TypeVar("T")
Answer = dict[str, Any]
Told = Callable[[Parameters, str, Mapping[str, Any]], None]
"""``told(parameters, who, changed)``: before the first step that is made with them."""

HISTORY: Final = 64
IN_CONTACT: Final = frozenset({State.CONTACT, State.RETREAT})
BUSY: Final = "another change is still being compiled"
NO_STATE: Final = (
    "there is no directory to save in: set `state` in the configuration, "
    "or StateDirectory= in the unit"
)

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class Changed:
    """One change that was made.

    Attributes:
        wall_s: when, since the epoch [s].
        values: by name, the old and the new value.
    """

    wall_s: float
    who: str
    values: Mapping[str, Mapping[str, Any]]


@dataclass(slots=True)
class Desk:
    """Parameters of a running daemon.

    Attributes:
        told: hears of a change before it is in force.
        said: hears of it in words, after.
        history: of changes, the newest last.
    """

    station: LoadedConfig
    cycle: Cycle
    told: Told = lambda _parameters, _who, _changed: None
    said: Callable[[str], None] = lambda _text: None
    settings: Settings = field(init=False)
    history: deque[Changed] = field(default_factory=lambda: deque(maxlen=HISTORY))
    _listed: dict[str, Parameter] = field(init=False)
    _saved: dict[str, Any] = field(init=False)
    _newest: Parameters = field(init=False)
    _compiling: asyncio.Future[Answer] | None = None

    def __post_init__(self) -> None:
        """Describe every parameter once, and warm up what reads them."""
        self.settings = overlays.settings_of(self.station.config)
        self._newest = self.cycle.parameters
        self._listed = {
            one["name"]: one for one in parameter_list.list_parameters(self.station.config)
        }
        for name, value in tree.leaves(self.station.written):
            if name in self._listed:
                self._listed[name]["file"] = value
        self._saved = dict(tree.leaves(self.settings))
        for section in tree.SECTIONS:
            tree.read_section(section, tree.plain(getattr(self.settings, section)))

    # What operators ask.

    def describe(self, params: Mapping[str, Any]) -> Answer:
        """Answer the operation ``params``."""
        return parameter_list.select(tuple(self._listed.values()), params)

    def get(self, params: Mapping[str, Any]) -> Answer:
        """Answer the operation ``get``."""
        return parameter_list.read_values(tuple(self._listed.values()), params)

    def set(self, values: Mapping[str, Any], who: str) -> Answer | asyncio.Future[Answer]:
        """Answer the operation ``set``: all of it or nothing.

        Returns:
            ``changed`` with old and new values, or ``refused``; a promise of that where a
            compiler is needed.
        """
        reason = self._unsettable(values)
        if reason is not None:
            return {"refused": reason}
        try:
            wanted = tree.change(self.settings, values)
        except SettingError as error:
            return {"refused": str(error)}
        changed = self._changes(values, wanted)
        if not changed:
            return {"changed": {}}
        reason = self._disordered(wanted) or self._beyond_robot(wanted)
        reason = reason or self._untimely(changed)
        if reason is not None:
            return {"refused": reason}
        if any(parameter_list.change_rule(name).change is ChangeTime.IDLE for name in changed):
            return self._compile(wanted, changed, who)
        return self._retune(wanted, changed, who)

    def save(self, who: str) -> Answer | asyncio.Future[Answer]:
        """Answer the operation ``save``: what is in force outlives the process."""
        folder = self.station.state
        if folder is None:
            return {"refused": NO_STATE}
        settings, kept = self.settings, dict(tree.leaves(self.settings))

        def done(path: Path) -> Answer:
            self._saved = kept
            for name, item in self._listed.items():
                item.pop("unsaved", None)
                if name in kept and kept[name] != item["value"]:
                    item["unsaved"] = True
            self._note(folder, {"who": who, "saved": str(path)})
            return {"saved": str(path)}

        work = _in_thread(overlays.save, folder, settings, self.station.written)
        return _then(work, done, lambda error: {"refused": f"not saved: {error}"})

    # How a change is made.

    def _unsettable(self, values: Mapping[str, Any]) -> str | None:
        for name in values:
            if (
                name in self._listed
                and parameter_list.change_rule(name).change is ChangeTime.RESTART
            ):
                return f"{name} is set in the configuration file and taken at the daemon's start"
        return None

    def _beyond_robot(self, wanted: Settings) -> str | None:
        """Return which limits would be wider than the URDF's, None if none."""
        if wanted.control is self.settings.control:
            return None
        task = self.station.task
        arm = task.file.arm
        found = urdf_limits.wider(
            wanted.control, task.urdf, arm.flange, linear_axis=arm.linear_axis
        )
        told = [f"control.limits.{axis}.{name}: {what}" for axis, name, what in found]
        return "; ".join(told) or None

    def _changes(self, values: Mapping[str, Any], wanted: Settings) -> dict[str, dict[str, Any]]:
        now = {name: self._listed[name]["value"] for name in values}
        then = {name: _at(wanted, name) for name in values}
        return {
            name: {"old": now[name], "new": then[name]}
            for name in values
            if then[name] != tree.plain(now[name])
        }

    def _disordered(self, wanted: Settings) -> str | None:
        """Return which time-out would never act, None if all can."""
        found = timeout_error(wanted.watch, self.cycle.parameters.cycle_s)
        return None if found is None else f"watch.{found[0]}: {found[1]}"

    def _untimely(self, names: Mapping[str, Any]) -> str | None:
        """Return why these may not change now, None if they may."""
        state = self.cycle.machine.state
        for name in names:
            found = parameter_list.change_rule(name)
            if state in IN_CONTACT and not found.in_contact:
                return f"{name} does not change in contact"
            if found.change is ChangeTime.IDLE and not self.cycle.stands:
                return f"{name} changes only while the robot stands idle, not in {state.upper()}"
        if self._compiling is not None:
            return BUSY
        return None

    def _retune(self, wanted: Settings, changed: Mapping[str, Any], who: str) -> Answer:
        """Make a change that fits between two steps."""
        if wanted.tracking != self.settings.tracking:
            # What was taken last may still wait for its step.
            made = compiling.retuned(self._newest, wanted.tracking)
            reason = self._unfit(made)
            if reason is not None:
                return {"refused": reason}
            self._take(made, who, changed)
        if wanted.watch != self.settings.watch:
            self.cycle.set_watch(wanted.watch)
        return self._made(wanted, changed, who)

    def _compile(
        self, wanted: Settings, changed: Mapping[str, Any], who: str
    ) -> asyncio.Future[Answer]:
        """Make a change that needs the compiler, in a thread."""
        station = self.station
        cycle_s = self._newest.cycle_s

        def done(made: Parameters) -> Answer:
            self._compiling = None
            reason = self._untimely(changed)
            if reason is not None:
                return {"refused": f"{reason}; it moved meanwhile"}
            self._take(made, who, changed, anew=True)
            self.cycle.set_watch(wanted.watch)
            return self._made(wanted, changed, who)

        def failed(error: BaseException) -> Answer:
            self._compiling = None
            return {"refused": f"{', '.join(changed)}: {error}"}

        task = station.task
        work = _in_thread(_build, task.file, task.urdf, wanted.tracking, wanted.control, cycle_s)
        self._compiling = _then(work, done, failed)
        return self._compiling

    def _unfit(self, made: Parameters) -> str | None:
        """Return why the next step could not be made with these, None if it could."""
        tried = self.cycle.trial()
        if tried is None:
            return None
        state, inputs = tried
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                _, outputs = stepping.step(state, replace(inputs, start=False), made)
        except (ValueError, ArithmeticError, IndexError) as error:
            return f"the next step could not be made: {type(error).__name__}: {error}"
        told = (*outputs.command, *outputs.target, outputs.confidence)
        if not all(map(math.isfinite, told)):
            return "the next step would come to no finite command"
        return None

    def _take(
        self, made: Parameters, who: str, changed: Mapping[str, Any], *, anew: bool = False
    ) -> None:
        self.told(made, who, changed)
        self.cycle.swap(made, restarts=anew)
        self._newest = made

    def _made(self, wanted: Settings, changed: Mapping[str, Any], who: str) -> Answer:
        self.settings = wanted
        for name, values in changed.items():
            item = self._listed[name]
            item["value"], item["by"] = values["new"], who
            item.pop("unsaved", None)
            if self._saved[name] != values["new"]:
                item["unsaved"] = True
        self.history.append(Changed(time.time(), who, changed))
        told = ", ".join(f"{name} {one['old']} -> {one['new']}" for name, one in changed.items())
        self.said(f"{who} set {told}")
        if self.station.state is not None:
            self._note(self.station.state, {"who": who, "changed": changed})
        return {"changed": dict(changed)}

    @staticmethod
    def _note(folder: Path, told: Mapping[str, Any]) -> None:
        """Add a line to the log of changes, behind the loop's back."""
        line = {"at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), **told}
        work = _in_thread(overlays.append_change, folder, line)
        work.add_done_callback(_complain)


def _build(*told: Any) -> Parameters:
    return compiling.build(*told)


def _at(settings: Settings, name: str) -> Any:
    """Return a value by its name, plain."""
    value: Any = settings
    for part in name.split("."):
        value = value[int(part)] if isinstance(value, tuple) else getattr(value, part)
    return tree.plain(value)


def _in_thread(work: Callable[..., T], *told: Any) -> asyncio.Future[T]:
    return asyncio.get_running_loop().run_in_executor(None, work, *told)


def _then(
    work: asyncio.Future[T],
    done: Callable[[T], Answer],
    failed: Callable[[BaseException], Answer],
) -> asyncio.Future[Answer]:
    """Return a promise of the answer that follows from some work."""
    promise: asyncio.Future[Answer] = asyncio.get_running_loop().create_future()

    def answer(finished: asyncio.Future[T]) -> None:
        if promise.done():
            return
        if finished.cancelled():
            promise.set_result(failed(asyncio.CancelledError("the daemon ends")))
            return
        error = finished.exception()
        promise.set_result(done(finished.result()) if error is None else failed(error))

    work.add_done_callback(answer)
    return promise


def _complain(done: "asyncio.Future[None]") -> None:
    error = None if done.cancelled() else done.exception()
    if error is not None:
        log.warning("the log of changes is not written: %s", error)
