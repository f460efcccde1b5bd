"""Mutation testing: ``python tests/mutants.py [FILE ...] [--share 0.1] [--seed 0] [--workers 1]``.

Each mutant is one small change of the syntax tree (a comparison, a boolean, a
number, an arithmetic sign, a branch, a return), put in the place of the module before its own
tests import it; the file on the disk is never touched. A mutant that its tests do not notice
survives and is printed with its line. Survivors that are shown to be equivalent stand in
``EQUIVALENT``.
"""

import argparse
import ast
import contextlib
import copy
import importlib.abc
import importlib.machinery
import importlib.util
import multiprocessing
import os
import random
import signal
import sys
import tempfile
import time
import types
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 180.0
FIRST_S = 900.0  # without a mutation, on a machine that has other work

TESTS: dict[str, tuple[str, ...]] = {
    "daemon/cycle/states.py": (
        "tests/cycle/test_states_transcript.py",
        "tests/cycle/test_states_cases.py",
        "tests/cycle/test_states.py",
    ),
    "daemon/cycle/watch.py": ("tests/cycle/test_watch.py", "tests/cycle/test_states_transcript.py"),
    "daemon/cycle/sensing/sensor_health.py": (
        "tests/cycle/test_sensor_transcript.py",
        "tests/cycle/test_sensor_health.py",
    ),
    "daemon/core/control/command_limiter.py": (
        "tests/core/control/test_command_limiter_transcript.py",
        "tests/core/control/test_command_limiter.py",
    ),
    "daemon/core/control/axis_limits.py": (
        "tests/core/control/test_command_limiter_transcript.py",
        "tests/core/control/test_command_limiter.py",
    ),
    "protocol/exchange.py": (
        "tests/protocol/test_exchange_transcript.py",
        "tests/protocol/test_exchange.py",
        "tests/protocol/test_exchange_pair.py",
        "tests/protocol/test_corners.py",
    ),
    "protocol/exchange_controller.py": (
        "tests/protocol/test_exchange_transcript.py",
        "tests/protocol/test_exchange_controller.py",
        "tests/protocol/test_exchange_pair.py",
    ),
    "protocol/rsi/codec.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_codec.py",
        "tests/protocol/test_telegram_reader.py",
        "tests/protocol/test_rsi_configuration.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/rsi/ethernet_config.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_codec.py",
        "tests/protocol/test_telegram_reader.py",
        "tests/protocol/test_rsi_configuration.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/rsi/telegram_layout.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_codec.py",
        "tests/protocol/test_telegram_reader.py",
        "tests/protocol/test_rsi_configuration.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/rsi/telegram_reader.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_codec.py",
        "tests/protocol/test_telegram_reader.py",
        "tests/protocol/test_rsi_configuration.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/rsi/xml_scan.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_codec.py",
        "tests/protocol/test_telegram_reader.py",
        "tests/protocol/test_rsi_configuration.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/rsi/telegram_writer.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_codec.py",
        "tests/protocol/test_telegram_reader.py",
        "tests/protocol/test_rsi_configuration.py",
    ),
    "protocol/sensors/camera_codec.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_camera_codec.py",
    ),
    "protocol/sensors/distance.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_distance.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/sensors/distance_bits.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_distance.py",
    ),
    "protocol/sensors/slcan.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_slcan.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/sensors/bota.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_wrench.py",
    ),
    "protocol/sensors/ft300.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_wrench.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/sensors/wrench_stream.py": (
        "tests/protocol/test_wires_transcript.py",
        "tests/protocol/test_wrench.py",
    ),
    "protocol/command/frame_codec.py": (
        "tests/protocol/test_frame_codec.py",
        "tests/protocol/test_local_server.py",
        "tests/protocol/test_edges.py",
    ),
    "protocol/command/payloads.py": (
        "tests/protocol/test_edges.py",
        "tests/protocol/test_frame_codec.py",
    ),
    "protocol/command/requests.py": (
        "tests/protocol/test_edges.py",
        "tests/protocol/test_frame_codec.py",
        "tests/protocol/test_conversation.py",
    ),
    "protocol/command/authenticated.py": (
        "tests/protocol/test_authenticated_edges.py",
        "tests/protocol/test_corners.py",
        "tests/protocol/test_authenticated.py",
    ),
}
"""What judges a mutant of each file, the quickest first."""

COMPARED: dict[type[ast.cmpop], type[ast.cmpop]] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot,
    ast.IsNot: ast.Is,
    ast.In: ast.NotIn,
    ast.NotIn: ast.In,
}
SIGNS: dict[type[ast.operator], type[ast.operator]] = {
    ast.Add: ast.Sub,
    ast.Sub: ast.Add,
    ast.Mult: ast.FloorDiv,
    ast.FloorDiv: ast.Mult,
    ast.Div: ast.Mult,
    ast.BitAnd: ast.BitOr,
    ast.BitOr: ast.BitAnd,
}


@dataclass(frozen=True)
class Mutant:
    """One change.

    Attributes:
        statement: the statement around it, its first line.
        what: was made of what.
        source: of the whole module.
    """

    file: str
    line: int
    function: str
    statement: str
    what: str
    source: str

    @property
    def reason(self) -> str | None:
        """Why no one can see it, None if somebody might."""
        return EQUIVALENT.get(self.file, {}).get((self.statement, self.what))


SHORT_CUTS = {"protocol/rsi/telegram_writer.py": frozenset({"_block"})}
"""Functions that only spare work. Taken too often their answer would differ, which a test notices;
taken too seldom it is the same: a mutant in them that survives is equivalent."""

IDLE_MEMORY = "not looked at before the first telegram has set it"
FIRST_POSE = "not looked at before the first pose has set it"
WHOLE_FRAME = "a frame that is not taken at once is taken as those of all streams are: the same"
INFINITE = "finite if and only if every part is, whatever the signs: none of 32 bits overflows"
PARTS = ("fx", "fy", "fz", "mx", "my", "mz", "temperature")
NO_SWEEP = "vectors that are not read in one sweep are read one by one: the same numbers"
MORE_THAN_FITS = "no number of so many hexadecimal digits is as great"
VALUED = (
    "_VALUED = {b'S': (CommandKind.BITRATE, 1, len(BITRATES)),"
    " b's': (CommandKind.BIT_TIMING, 4, 1 << 16), b'Z': (CommandKind.STAMPS, 1, 2),"
    " b'M': (CommandKind.ACCEPTANCE_CODE, 8, 1 << 32),"
    " b'm': (CommandKind.ACCEPTANCE_MASK, 8, 1 << 32)}"
)
EQUIVALENT: dict[str, dict[tuple[str, str], str]] = {
    "protocol/exchange.py": {
        ("if self.length and 0 < delta <= reach:", "0 < delta <= reach -> 0 <= delta <= reach"): (
            "no difference is zero here: the two lines above return"
        ),
        ("self.length, self.step = (1, 0)", "0 -> 1"): "the second of a line counts two either way",
        ("self.length, self.step = (1, 0)", "1 -> 2"): "the second of a line counts two either way",
        ("self.length = self.length + 1 if delta == self.step else 2", "1 -> 2"): (
            "three are enough, and the third is more than that either way"
        ),
        ("self._cycle_ns = max(1, round(cycle_s * 1000000000.0))", "1 -> 2"): (
            "no cycle is shorter than two nanoseconds"
        ),
        (
            "self._cycle_ns = max(1, round(cycle_s * 1000000000.0))",
            "1000000000.0 -> 1000000001.0",
        ): ("the same nanosecond for every cycle below half a second"),
        (
            "self._peer_gap_ns = round(peer_gap_s * 1000000000.0)",
            "1000000000.0 -> 1000000001.0",
        ): "the same nanosecond for every gap below half a second",
        (
            "self._reach = WINDOW * max(1, round(cycle_s * 1000.0))",
            "1000.0 -> 1001.0",
        ): "the same for every cycle of whole milliseconds",
        (
            "line = self._line if event is TelegramEvent.RESYNC else _TelegramLine(counter, 0, 1)",
            "1 -> 2",
        ): "the second of a line counts two either way",
        ("if delta < 0:", "delta < 0 -> delta <= 0"): "no difference is zero here",
        ("if delta < 0:", "0 -> 1"): "no difference is zero here",
        ("length: int = 0", "0 -> 1"): "a line that is looked at was begun by its first telegram",
        ("counter: int = 0", "0 -> 1"): "a line that is looked at was begun by its first telegram",
        ("step: int = 0", "0 -> 1"): "a line that is looked at was begun by its first telegram",
        ("self._last_counter = 0", "0 -> 1"): IDLE_MEMORY,
        ("self._last_ns = 0", "0 -> 1"): IDLE_MEMORY,
        ("self._peer_ns = 0", "0 -> 1"): IDLE_MEMORY,
        ("self._anchor_counter = 0", "0 -> 1"): IDLE_MEMORY,
        ("self._anchor_ns = 0", "0 -> 1"): IDLE_MEMORY,
    },
    "protocol/sensors/camera_codec.py": {
        (f"self.{name} = 0", "0 -> 1"): FIRST_POSE
        for name in ("reset", "t_tx", "arrival_ns", "candidates", "jumps")
    },
    "daemon/cycle/sensing/sensor_health.py": {
        ("self._same = 0", "0 -> 1"): "no pose and no wrench is like none: the first one counts 1",
        ("self._changed_ns = 0", "0 -> 1"): "the first distance differs from none and sets it",
    },
    "protocol/sensors/distance.py": {
        (
            "while signal.multiplexer_signal and signal.multiplexer_ids:",
            "signal.multiplexer_signal and signal.multiplexer_ids ->"
            " signal.multiplexer_signal or signal.multiplexer_ids",
        ): "a signal has both or neither"
    },
    "protocol/rsi/codec.py": {
        (
            f"{name} = [(q {sign} reach) / scale for q, scale in zip(joints, scales, strict=True)]",
            "True -> False",
        ): "the other of the two lines refuses as many"
        for name, sign in (("low", "-"), ("high", "+"))
    }
    | {
        ("first = fields[0] if fields else 0", "0 -> 1"): NO_SWEEP,
        (
            "self._is_block = all((vector.contiguous for vector in vectors)) and"
            " fields == list(range(first, first + len(fields)))",
            "first + len(fields) -> first - len(fields)",
        ): NO_SWEEP,
    },
    "protocol/command/requests.py": {
        (
            "width = {222: 2, 223: 4}.get(head, 0)",
            "0 -> 1",
        ): "only what was read as a map is counted"
    }
    | {
        (f"class {name}(Struct, frozen=True, forbid_unknown_fields=True):", "True -> False"): (
            "no one writes to a message, and an unknown field is one more than were read"
        )
        for name in (
            *("Empty", "ParamsOf", "GetOf", "SetOf", "RecordOf", "SubscribeOf", "PageOf"),
            "_RequestWire",
        )
    },
    "protocol/sensors/slcan.py": {
        (VALUED, "16 -> 17"): MORE_THAN_FITS,
        (VALUED, "32 -> 33"): MORE_THAN_FITS,
        (
            "letter = 'tTrR'[frame.extended + 2 * frame.remote]",
            "frame.extended + 2 * frame.remote -> frame.extended - 2 * frame.remote",
        ): "two from the end of four letters is two from their beginning",
    },
    "protocol/sensors/bota.py": {
        ("crc = fastcrc.crc16.ibm_sdlc(data[1:35])", what): WHOLE_FRAME
        for what in ("1 -> 2", "35 -> 36")
    }
    | {
        (
            "if not math.isfinite(fx + fy + fz + mx + my + mz + temperature):",
            f"{' + '.join(PARTS[:n])} + {PARTS[n]} -> {' + '.join(PARTS[:n])} - {PARTS[n]}",
        ): INFINITE
        for n in range(1, 7)
    },
}
"""Changes that no one can see, by file, statement and change, each with its reason."""


def mutants(file: str) -> Iterator[Mutant]:
    """Every mutant of a file, in the order of its lines."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    spared = {id(part) for node in ast.walk(tree) for part in _decorating(node)}
    around, inside = _heads(tree, ast.stmt), _heads(tree, ast.FunctionDef)
    for n, node in enumerate(ast.walk(tree)):
        if id(node) in spared:
            continue
        for change in _changes(node):
            mutated = copy.deepcopy(tree)
            twin = next(other for m, other in enumerate(ast.walk(mutated)) if m == n)
            before = ast.unparse(twin)
            change(twin)
            after = ast.unparse(ast.fix_missing_locations(twin))
            line = getattr(node, "lineno", 0)
            what = f"{before} -> {after}"[:160]
            function, statement = inside.get(id(node), ""), around.get(id(node), "")
            yield Mutant(file, line, function, statement, what, ast.unparse(mutated))


def _heads(tree: ast.AST, kind: type[ast.stmt]) -> dict[int, str]:
    """The first line of the innermost statement around each node, or its function's name."""
    around: dict[int, str] = {}
    for statement in ast.walk(tree):
        if isinstance(statement, kind):
            name = getattr(statement, "name", "") if kind is ast.FunctionDef else ""
            head = name or ast.unparse(statement).partition("\n")[0]
            # Walked from the outside in: what is further in comes later and stays.
            around.update(dict.fromkeys(map(id, ast.walk(statement)), head))
    return around


def _decorating(node: ast.AST) -> Iterator[ast.AST]:
    """Options of decorators and structs: frozen, slots and cache sizes change no result."""
    options = [word for word in getattr(node, "keywords", ()) if word.arg in {"frozen", "eq"}]
    for option in (*getattr(node, "decorator_list", ()), *options):
        yield from ast.walk(option)


def _changes(node: ast.AST) -> Iterator[Callable[[ast.AST], None]]:
    """What can be changed at a node."""
    match node:
        case ast.Compare(ops=ops):
            for i, op in enumerate(ops):
                if type(op) in COMPARED:
                    yield _setter("ops", COMPARED[type(op)](), i)
        case ast.BoolOp(op=op):
            yield _setter("op", ast.Or() if isinstance(op, ast.And) else ast.And())
        case ast.BinOp(op=op) if type(op) in SIGNS and not _is_text(node):
            yield _setter("op", SIGNS[type(op)]())
        case ast.UnaryOp(op=ast.Not()):
            yield _setter("op", ast.UAdd())
        case ast.Constant(value=bool() as value):
            yield _setter("value", not value)
        case ast.Constant(value=int() | float() as value):
            yield _setter("value", value + 1)
        case ast.If() | ast.While() | ast.IfExp():
            test = ast.UnaryOp(ast.Not(), node.test)
            yield _setter("test", test)
        case ast.Return(value=ast.expr() as value) if not isinstance(value, ast.Constant):
            yield _setter("value", ast.Constant(None))


def _is_text(node: ast.AST) -> bool:
    """A union of types or a joined text, which is no arithmetic."""
    return any(
        isinstance(part, ast.Constant) and (part.value is None or isinstance(part.value, str))
        for part in ast.walk(node)
    )


def _setter(name: str, value: object, index: int | None = None) -> Callable[[ast.AST], None]:
    def change(node: ast.AST) -> None:
        if index is None:
            setattr(node, name, copy.deepcopy(value))
        else:
            getattr(node, name)[index] = value

    return change


HEAVY = (
    "pytest",
    "hypothesis.strategies",
    "numpy",
    "scipy.linalg",
    "msgspec",
    "msgpack",
    "cantools",
    "pydantic",
    "pinocchio",
    "xml.etree.ElementTree",
)
"""Loaded once and forked with, for they are no mutant's; nothing of the project is."""


class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    """Gives one module of the project with another source."""

    def __init__(self, name: str, file: str, source: str) -> None:
        self._name, self._file, self._source = name, file, source

    def find_spec(
        self, fullname: str, path: object = None, target: object = None
    ) -> importlib.machinery.ModuleSpec | None:
        del path, target
        if fullname != self._name:
            return None
        return importlib.util.spec_from_loader(fullname, self, origin=self._file)

    def exec_module(self, module: types.ModuleType) -> None:
        module.__file__ = self._file
        exec(compile(self._source, self._file, "exec"), module.__dict__)


def warm() -> None:
    """Load what every mutant's tests load."""
    for name in HEAVY:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)


def survives(file: str, source: str, longest_s: float = LONGEST_S) -> bool:
    """Whether a file's tests do not notice that it has another source; a hang is noticed."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            os.setsid()
            nothing = os.open(os.devnull, os.O_RDWR)
            for descriptor in (0, 1, 2):
                os.dup2(nothing, descriptor)
            os.chdir(ROOT)
            name = "linemate." + file.removesuffix(".py").replace("/", ".")
            sys.meta_path.insert(0, Finder(name, str(ROOT / file), source))
            import pytest

            code = int(
                pytest.main([*["-x", "-q", "-p", "no:cacheprovider", "-W", "ignore"], *TESTS[file]])
            )
        finally:
            os._exit(code)
    end = time.monotonic() + longest_s
    while time.monotonic() < end:
        done, status = os.waitpid(pid, os.WNOHANG)
        if done:
            return os.waitstatus_to_exitcode(status) == 0
        time.sleep(0.01)
    os.killpg(pid, signal.SIGKILL)
    os.waitpid(pid, 0)
    return False


def _judge(mutant: Mutant, longest_s: float) -> bool:
    return survives(mutant.file, mutant.source, longest_s)


def main(argv: Sequence[str] | None = None) -> int:
    """Report; 1 if fewer than nine in ten were killed."""
    parser = argparse.ArgumentParser(prog="mutants", description="Mutation testing.")
    parser.add_argument("files", nargs="*", default=list(TESTS), metavar="FILE")
    parser.add_argument("--share", type=float, default=1.0, help="of the mutants, drawn by seed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--bar", type=float, default=0.9, help="share to be killed")
    args = parser.parse_args(argv)
    killed = total = 0
    warm()
    with tempfile.TemporaryDirectory() as name:
        # What killed one mutant is tried first on the next.
        os.environ["HYPOTHESIS_STORAGE_DIRECTORY"] = name
        context = multiprocessing.get_context("fork")
        with ProcessPoolExecutor(args.workers, mp_context=context) as pool:
            for file in args.files:
                dead, count = _report(file, args, pool)
                killed, total = killed + dead, total + count
    print(f"{killed} of {total} killed, {100.0 * killed / total:.1f} %")
    return 0 if killed >= args.bar * total else 1


def _report(file: str, args: argparse.Namespace, pool: ProcessPoolExecutor) -> tuple[int, int]:
    """Try a file's mutants; how many were killed, of how many."""
    begun = time.monotonic()
    if not survives(file, (ROOT / file).read_text(encoding="utf-8"), FIRST_S):
        raise SystemExit(f"{file}: its own tests fail without any mutation")
    longest_s = min(LONGEST_S, 5.0 + 5.0 * args.workers * (time.monotonic() - begun))
    every = [m for m in mutants(file) if m.reason is None]
    drawn = random.Random(f"{args.seed}/{file}").sample(
        every, max(1, round(args.share * len(every)))
    )
    dead = spared = 0
    short_cuts = SHORT_CUTS.get(file, frozenset())
    for mutant, alive in zip(drawn, pool.map(_judge, drawn, [longest_s] * len(drawn)), strict=True):
        dead += not alive
        if alive and mutant.function in short_cuts:
            spared += 1
        elif alive:
            print(f"  survives {mutant.file}:{mutant.line}: {mutant.what}", flush=True)
    count = len(drawn) - spared
    known = len(EQUIVALENT.get(file, {}))
    print(
        f"{file}: {dead} of {count} killed ({len(every)} there are, {known} more and"
        f" {spared} of these are equivalent)",
        flush=True,
    )
    return dead, count


if __name__ == "__main__":
    assert importlib.util.find_spec("linemate") is not None
    sys.exit(main())
