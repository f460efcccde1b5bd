"""The section ``rsi``: the controller's own file that it names, and what makes it unsafe.

Each error names the element and what to change.

Invariants:
- Values of the wrong kind are passed over. ``documents.fill`` refuses them.
"""

from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from linemate.daemon.config import files
from linemate.daemon.config.reading.complaints import Complaint
from linemate.daemon.config.section_checks import PlainValues, waiting_gates
from linemate.daemon.config.settings import Corrections
from linemate.daemon.core.tracking.task import TaskFile
from linemate.protocol.rsi.codec import RsiCodec
from linemate.protocol.rsi.ethernet_config import (
    MAX_CONFIG_BYTES,
    PLACEHOLDER,
    Element,
    RsiConfig,
    parse_config,
)

DEFAULT_FILE = "rsi_joints.xml"
JOINT_WORDS = frozenset({"AK", "AKorr"})
EXTERNAL_WORDS = frozenset({"EK", "EKorr"})
SIGNALS_OUT = "DiO"
SIGNALS_IN = "DiL"
MESSAGE = "DEF_EStr"

_KINDS: dict[str, tuple[type, ...]] = {
    "BOOL": (bool, int),
    "LONG": (int,),
    "DOUBLE": (int, float),
    "STRING": (str,),
}


def read(values: PlainValues, base: Path) -> tuple[RsiConfig, str] | None:
    """Return the controller's file, parsed and as text; None if the section names none.

    Raises:
        UnreadableError: the file cannot be read.
        RsiError: it is not one.
    """
    name = DEFAULT_FILE
    if values.has("rsi"):
        name = values.get("rsi", "config", kind=str, default=DEFAULT_FILE) or ""
    if not name:
        return None
    data = files.read(files.find(name, base, files.PROTOCOL_DATA), MAX_CONFIG_BYTES)
    file = parse_config(data)
    RsiCodec(file)
    return file, data.decode("utf-8", errors="replace")


def complaints(values: PlainValues, file: RsiConfig, task: TaskFile | None) -> Iterator[Complaint]:
    """Yield what the controller's file must not hold, or lacks.

    Args:
        values: of the whole configuration.
        task: None if it cannot be read.
    """
    corrections = values.get("rsi", "corrections", kind=str, default=Corrections.ABSOLUTE.value)
    constants: dict[str, Any] = values.get("rsi", "constants", kind=dict, default={}) or {}
    errors = [*unfilled(file, constants)]
    if corrections in list(Corrections):
        errors = [*exchange_errors(file, Corrections(corrections)), *errors]
    if task is not None:
        missing = missing_axes(file, linear_axis=task.arm.linear_axis)
        if missing:
            errors = [f"the task's arm needs {', '.join(missing)}", *errors]
        errors += gate_errors(file, task)
    for what in errors:
        yield Complaint(("rsi", "config"), what)
    for tag, what in constant_errors(file, constants):
        yield Complaint(("rsi", "constants", tag), what)


def is_correction(element: Element) -> bool:
    """Whether a RECEIVE element carries the correction of an axis."""
    return element.tag.partition(".")[0] in JOINT_WORDS | EXTERNAL_WORDS


def exchange_errors(rsi: RsiConfig, corrections: Corrections) -> Iterator[str]:
    """Return what makes a lost reply or a restart move the robot.

    Args:
        corrections: how the controller reads them.
    """
    if rsi.onlysend:
        yield "ONLYSEND is TRUE: the controller takes no replies. Set ONLYSEND to FALSE."
    if "DEF_Delay" not in {element.tag for element in rsi.send}:
        yield (
            "SEND has no DEF_Delay: lost replies cannot be seen. Add "
            '<ELEMENT TAG="DEF_Delay" TYPE="LONG" INDX="INTERNAL"/> to SEND.'
        )
    channels = Counter(element.index for element in rsi.receive if element.index is not None)
    for channel, count in channels.items():
        if count > 1:
            shared = ", ".join(e.tag for e in rsi.receive if e.index == channel)
            yield (
                f'RECEIVE {shared}: INDX="{channel}" {count} times. One output of the ETHERNET '
                "object moves one axis: give each element its own."
            )
    # A lost reply leaves an absolute correction in force (1), and adds no increment (0).
    wanted = corrections is Corrections.ABSOLUTE
    wrong = [e.tag for e in rsi.receive if is_correction(e) and e.holdon is not wanted]
    if wrong:
        effect = "takes the whole correction back" if wanted else "repeats the last increment"
        yield (
            f'RECEIVE {", ".join(wrong)}: HOLDON="{int(not wanted)}" with {corrections} '
            f'corrections: a lost reply {effect}. Set HOLDON="{int(wanted)}".'
        )


def missing_axes(rsi: RsiConfig, *, linear_axis: bool) -> list[str]:
    """Return the positions and corrections of axes that the file lacks, or empty.

    Args:
        linear_axis: the arm stands on E1.
    """
    sends, axes = ["DEF_AIPos"], [f"A{i}" for i in range(1, 7)]
    if linear_axis:
        sends, axes = [*sends, "DEF_EIPos"], [*axes, "E1"]
    sent = {element.tag for element in rsi.send}
    corrected = {e.tag.partition(".")[2] for e in rsi.receive if is_correction(e)}
    missing = [f"SEND {tag}" for tag in sends if tag not in sent]
    word = {"A": "AK", "E": "EK"}
    return missing + [f"RECEIVE {word[a[0]]}.{a}" for a in axes if a not in corrected]


def unfilled(rsi: RsiConfig, constants: Mapping[str, Any]) -> Iterator[str]:
    """Return RECEIVE elements that replies have no value for."""
    without = [
        element.tag
        for element in rsi.receive
        if not (is_correction(element) or element.tag in {SIGNALS_OUT, MESSAGE, PLACEHOLDER})
        and element.tag not in constants
    ]
    if without:
        example = ", ".join(f"{tag}: VALUE" for tag in without)
        yield (
            f"RECEIVE {', '.join(without)}: linemate has no value for it and would write 0. "
            f"Give rsi.constants: {{{example}}}, or remove it from the file and the controller."
        )


def constant_errors(rsi: RsiConfig, constants: Mapping[str, Any]) -> Iterator[tuple[str, str]]:
    """Return the TAG and what is wrong for each constant that cannot be written."""
    elements = {element.tag: element for element in rsi.receive}
    for tag, value in constants.items():
        element = elements.get(tag)
        if element is None:
            known = ", ".join(elements) or "nothing"
            yield tag, f"no element of RECEIVE, which has {known}"
        elif is_correction(element) or tag in {SIGNALS_OUT, MESSAGE}:
            yield tag, "linemate writes it in every reply: remove the constant"
        elif not _fits(element, value):
            yield tag, f"should be a {element.type} as TYPE says, not {value!r}"


def _fits(element: Element, value: object) -> bool:
    if isinstance(value, bool):
        return element.type == "BOOL"
    if element.type == "BOOL" and value not in (0, 1):
        return False
    return isinstance(value, _KINDS[element.type])


def gate_errors(rsi: RsiConfig, task: TaskFile) -> Iterator[str]:
    """Return gates of a task that wait for a signal which the controller does not carry.

    Args:
        task: with its gates and the times that stand for signals.
    """
    has_signals = SIGNALS_IN in {element.tag for element in rsi.send}
    has_orders = SIGNALS_OUT in {element.tag for element in rsi.receive}
    if has_signals and has_orders:
        return
    missing = [f"SEND {SIGNALS_IN}"] if not has_signals else []
    missing += [f"RECEIVE {SIGNALS_OUT}"] if not has_orders else []
    for waits, key in waiting_gates(task):
        yield (
            f"{waits}, and the file has no {' and no '.join(missing)}. "
            f"Add the channel, or set {key}."
        )
