"""Parameter service: checks, changes and saves the parameters of a running daemon.

Invariants:
- A change is made as a whole, as one new frozen set, or refused as a whole.
- A live change is computed after a reply. A change that needs the compiler runs in a thread, and
  is used only if the robot still stands. Files are written in a thread.
- A refusal names the parameter and the reason.
"""

import asyncio
import logging
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final, TypeVar

import numpy as np
from msgspec import structs

from linemate.daemon.config import overlays, parameter_list
from linemate.daemon.config import settings_tree as tree
from linemate.daemon.config.config import LoadedConfig, device_complaints
from linemate.daemon.config.documents import spelled
from linemate.daemon.config.parameter_list import ChangeTime, Parameter
from linemate.daemon.config.section_checks import DRIFT_LEARNED
from linemate.daemon.config.settings_tree import SettingError, Settings
from linemate.daemon.config.watch_settings import timeout_error
from linemate.daemon.core import parameters as compiling
from linemate.daemon.core import step as stepping
from linemate.daemon.core.control import urdf_limits
from linemate.daemon.core.parameters import Parameters
from linemate.daemon.cycle.cycle import Cycle
from linemate.daemon.cycle.watch import IN_CONTACT

T = TypeVar("T")
Answer = dict[str, Any]
# on_change(parameters, who, changed), before the first step that uses the parameters.
OnChange = Callable[[Parameters, str, Mapping[str, Any]], None]

BUSY: Final = "another change is still being compiled"
NO_STATE: Final = (
    "there is no directory to save in: set `state` in the configuration, "
    "or StateDirectory= in the unit"
)

log = logging.getLogger(__name__)


@dataclass(slots=True)
class ParameterService:
    """Parameters of a running daemon.

    Attributes:
        on_change: called before a change is in force.
        on_event: called with a line about a change, after it.
    """

    station: LoadedConfig
    cycle: Cycle
    on_change: OnChange = lambda _parameters, _who, _changed: None
    on_event: Callable[[str], None] = lambda _text: None
    settings: Settings = field(init=False)
    _listed: dict[str, Parameter] = field(init=False)
    _saved: dict[str, Any] = field(init=False)
    _newest: Parameters = field(init=False)
    _compiling: asyncio.Future[Answer] | None = None

    def __post_init__(self) -> None:
        """Describe every parameter once, and warm up the reader of changes."""
        self.settings = overlays.settings_of(self.station.config)
        self._newest = self.cycle.parameters
        listed = parameter_list.list_parameters(self.station.config)
        self._listed = {parameter["name"]: parameter for parameter in listed}
        for name, value in tree.leaves(self.station.written):
            if name in self._listed:
                self._listed[name]["file"] = value
        self._saved = dict(tree.leaves(self.settings))
        for section in tree.SECTIONS:
            tree.read_section(section, tree.plain(getattr(self.settings, section)))

    def describe(self, params: Mapping[str, Any]) -> Answer:
        """Answer the operation ``params``."""
        return parameter_list.select(tuple(self._listed.values()), params)

    def get(self, params: Mapping[str, Any]) -> Answer:
        """Answer the operation ``get``."""
        return parameter_list.read_values(tuple(self._listed.values()), params)

    def set(self, values: Mapping[str, Any], who: str) -> Answer | asyncio.Future[Answer]:
        """Answer the operation ``set``.

        Args:
            values: new values by dotted name.

        Returns:
            ``changed`` with old and new values, or ``refused``; a future of that if the change
            needs the compiler.
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
        reason = reason or self._beyond_devices(wanted) or self._learned_as_servos(wanted)
        reason = reason or self._untimely(changed)
        if reason is not None:
            return {"refused": reason}
        rules = map(parameter_list.change_rule, changed)
        if any(rule.change is ChangeTime.IDLE for rule in rules):
            return self._compile(wanted, changed, who)
        return self._change_live(wanted, changed, who)

    def follow(self, parameters: Parameters) -> None:
        """Take the parameters of another task as those that changes begin from."""
        self._newest = parameters

    def save(self, who: str) -> Answer | asyncio.Future[Answer]:
        """Answer the operation ``save``: keep the settings in force for the next start."""
        folder = self.station.state
        if folder is None:
            return {"refused": NO_STATE}
        settings, saved = self.settings, dict(tree.leaves(self.settings))

        def done(path: Path) -> Answer:
            self._saved = saved
            for name, parameter in self._listed.items():
                parameter.pop("unsaved", None)
                if name in saved and saved[name] != parameter["value"]:
                    parameter["unsaved"] = True
            self._log_change(folder, {"who": who, "saved": str(path)})
            return {"saved": str(path)}

        work = _in_thread(overlays.save, folder, settings, self.station.written)
        return _then(work, done, lambda error: {"refused": f"not saved in {folder}: {error}"})

    def _unsettable(self, values: Mapping[str, Any]) -> str | None:
        """Return which parameter needs a restart, None if none does."""
        for name in values:
            rule = parameter_list.change_rule(name)
            if name in self._listed and rule.change is ChangeTime.RESTART:
                return f"{name} changes only with a restart. Set it in the configuration file."
        return None

    def _beyond_robot(self, wanted: Settings) -> str | None:
        """Return which limits would be wider than the URDF's, None if none."""
        if wanted.control is self.settings.control:
            return None
        task = self.station.task
        arm = task.file.arm
        wider = urdf_limits.wider(
            wanted.control, task.urdf, arm.flange, linear_axis=arm.linear_axis
        )
        lines = [f"control.limits.{axis}.{name}: {what}" for axis, name, what in wider]
        return "; ".join(lines) or None

    def _beyond_devices(self, wanted: Settings) -> str | None:
        """Return what the mount or a sensor cannot have, None if nothing."""
        if wanted.tracking is self.settings.tracking:
            return None
        station = self.station
        complaints = device_complaints(station.config, wanted.tracking, station.count_m)
        return "; ".join(f"{spelled(c.path)}: {c.what}" for c in complaints) or None

    def _learned_as_servos(self, wanted: Settings) -> str | None:
        """Return why dead times may not drift, None if they may."""
        drift = wanted.control.drift
        if self.station.config.learning is None or not (drift.shorter or drift.longer):
            return None
        return f"control.drift: learning is set: {DRIFT_LEARNED} Remove learning first."

    def _changes(self, values: Mapping[str, Any], wanted: Settings) -> dict[str, dict[str, Any]]:
        """Return old and new value of each parameter that changes."""
        new = dict(tree.leaves(wanted))
        return {
            name: {"old": self._listed[name]["value"], "new": new[name]}
            for name in values
            if new[name] != self._listed[name]["value"]
        }

    def _disordered(self, wanted: Settings) -> str | None:
        """Return which time-out would never act, None if all can."""
        error = timeout_error(wanted.watch, self.cycle.parameters.cycle_s)
        return None if error is None else f"watch.{error[0]}: {error[1]}"

    def _untimely(self, names: Mapping[str, Any]) -> str | None:
        """Return why these may not change now, None if they may."""
        state, last = self.cycle.machine.state, self.cycle.last
        # A fault may have left the tool on the object: a new state would forget that.
        is_held = last is not None and (last.outputs.contact or last.outputs.clamped)
        for name in names:
            rule = parameter_list.change_rule(name)
            if (is_held or state in IN_CONTACT) and not rule.in_contact:
                return f"{name} does not change in contact"
            if rule.change is ChangeTime.IDLE and self.station.variants:
                return f"{name} changes only with a restart: each variant is compiled at start"
            if not (rule.in_motion or self.cycle.stands):
                return f"{name} changes only while the robot stands idle, not in {state.upper()}"
        if self._compiling is not None:
            return BUSY
        return None

    def _change_live(self, wanted: Settings, changed: Mapping[str, Any], who: str) -> Answer:
        """Make a change between two steps."""
        if wanted.tracking != self.settings.tracking:
            # The newest parameters may not be in force yet.
            parameters = compiling.retuned(self._newest, wanted.tracking)
            reason = self._unfit(parameters)
            if reason is not None:
                return {"refused": reason}
            self._use(parameters, who, changed)
        if wanted.watch != self.settings.watch:
            self.cycle.set_watch(wanted.watch)
        return self._finish(wanted, changed, who)

    def _compile(
        self, wanted: Settings, changed: Mapping[str, Any], who: str
    ) -> asyncio.Future[Answer]:
        """Make a change that needs the compiler, in a thread."""
        task, cycle_s = self.station.task, self._newest.cycle_s

        def done(parameters: Parameters) -> Answer:
            self._compiling = None
            reason = self._untimely(changed)
            if reason is not None:
                return {"refused": f"{reason}; it has moved since"}
            self._use(parameters, who, changed, restarts=True)
            self.cycle.set_watch(wanted.watch)
            return self._finish(wanted, changed, who)

        def failed(error: BaseException) -> Answer:
            self._compiling = None
            return {"refused": f"{', '.join(changed)}: {error}"}

        work = _in_thread(_build, task.file, task.urdf, wanted.tracking, wanted.control, cycle_s)
        self._compiling = _then(work, done, failed)
        return self._compiling

    def _unfit(self, parameters: Parameters) -> str | None:
        """Return why the next step would fail with these parameters, None if it would not."""
        trial = self.cycle.trial()
        if trial is None:
            return None
        state, inputs = trial
        try:
            with np.errstate(over="raise", invalid="raise", divide="raise"):
                inputs = structs.replace(inputs, start=False)
                _, outputs = stepping.step(state, inputs, parameters)
        except (ValueError, ArithmeticError, IndexError) as error:
            return f"the next step could not be made: {type(error).__name__}: {error}"
        numbers = (*outputs.command, *outputs.target, outputs.confidence)
        if not all(map(math.isfinite, numbers)):
            return "the next step would come to no finite command"
        return None

    def _use(
        self,
        parameters: Parameters,
        who: str,
        changed: Mapping[str, Any],
        *,
        restarts: bool = False,
    ) -> None:
        self.on_change(parameters, who, changed)
        self.cycle.swap(parameters, restarts=restarts)
        self._newest = parameters

    def _finish(self, wanted: Settings, changed: Mapping[str, Any], who: str) -> Answer:
        """List, report and log a change that is in force."""
        self.settings = wanted
        for name, values in changed.items():
            parameter = self._listed[name]
            parameter["value"], parameter["by"] = values["new"], who
            parameter.pop("unsaved", None)
            if self._saved[name] != values["new"]:
                parameter["unsaved"] = True
        lines = [f"{name} {values['old']} -> {values['new']}" for name, values in changed.items()]
        self.on_event(f"{who} set {', '.join(lines)}")
        if self.station.state is not None:
            self._log_change(self.station.state, {"who": who, "changed": changed})
        return {"changed": dict(changed)}

    @staticmethod
    def _log_change(folder: Path, change: Mapping[str, Any]) -> None:
        """Append a line to the log of changes, in a thread."""
        line = {"at": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime()), **change}
        work = _in_thread(overlays.append_change, folder, line)
        work.add_done_callback(_warn_of_failure)


def _build(*arguments: Any) -> Parameters:
    return compiling.build(*arguments)


def _in_thread(work: Callable[..., T], *arguments: Any) -> asyncio.Future[T]:
    return asyncio.get_running_loop().run_in_executor(None, work, *arguments)


def _then(
    work: asyncio.Future[T], done: Callable[[T], Answer], failed: Callable[[BaseException], Answer]
) -> asyncio.Future[Answer]:
    """Return a future of the answer that follows from some work."""
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


def _warn_of_failure(done: "asyncio.Future[None]") -> None:
    error = None if done.cancelled() else done.exception()
    if error is not None:
        log.warning("the log of changes is not written: %s", error)
