"""Mutation testing: ``python tests/mutants.py [FILE ...] [--share 0.1] [--seed 0] [--workers 1]``.

Law of this file: each mutant is one small change of the syntax tree (a comparison, a boolean, a
number, an arithmetic sign, a branch, a return), put in the place of the module before its own
tests import it; the file on the disk is never touched. A mutant that its tests do not notice
survives and is printed with its line. Survivors that are shown to be equivalent stand in
``EQUIVALENT``.
"""

import argparse
import ast
import copy
import importlib.util
import os
import random
import subprocess
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LONGEST_S = 180.0

TESTS: dict[str, tuple[str, ...]] = {
    "daemon/service/states.py": ("tests/service/test_states.py",),
    "daemon/service/watch.py": ("tests/service/test_watch.py",),
    "daemon/service/sensor_health.py": ("tests/service/test_sensor_health.py",),
    "daemon/control/limits.py": ("tests/control/test_limits.py",),
    "protocol/exchange.py": ("tests/protocol/test_exchange.py", "tests/protocol/test_corners.py"),
    "protocol/exchange_controller.py": ("tests/protocol/test_exchange.py",),
    "protocol/rsi_read.py": ("tests/protocol/test_rsi.py",),
    "protocol/rsi_scan.py": ("tests/protocol/test_rsi.py",),
    "protocol/rsi_write.py": ("tests/protocol/test_rsi.py",),
    "protocol/camera.py": ("tests/protocol/test_camera.py",),
    "protocol/distance.py": ("tests/protocol/test_distance.py",),
    "protocol/slcan.py": ("tests/protocol/test_slcan.py",),
    "protocol/wrench_bota.py": ("tests/protocol/test_wrench.py",),
    "protocol/wrench_ft300.py": ("tests/protocol/test_wrench.py",),
    "protocol/wrench_stream.py": ("tests/protocol/test_wrench.py",),
    "protocol/command.py": ("tests/protocol/test_command.py",),
    "protocol/command_session.py": ("tests/protocol/test_command_session.py",),
}
"""What judges a mutant of each file."""

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
        file: of the project.
        line: where.
        what: was made of what.
        source: of the whole module.
    """

    file: str
    line: int
    what: str
    source: str


EQUIVALENT: frozenset[tuple[str, str]] = frozenset()
"""(file, what) of changes that change nothing anybody can see, each with its reason beside it."""


def mutants(file: str) -> Iterator[Mutant]:
    """Every mutant of a file, in the order of its lines."""
    tree = ast.parse((ROOT / file).read_text(encoding="utf-8"))
    for n, node in enumerate(ast.walk(tree)):
        for change in _changes(node):
            mutated = copy.deepcopy(tree)
            twin = next(other for m, other in enumerate(ast.walk(mutated)) if m == n)
            before = ast.unparse(twin)
            change(twin)
            after = ast.unparse(ast.fix_missing_locations(twin))
            line = getattr(node, "lineno", 0)
            yield Mutant(file, line, f"{before} -> {after}"[:160], ast.unparse(mutated))


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


HOOK = """
import sys, importlib.abc, importlib.util
class Finder(importlib.abc.MetaPathFinder, importlib.abc.Loader):
    def find_spec(self, name, path=None, target=None):
        if name != NAME:
            return None
        return importlib.util.spec_from_loader(name, self, origin=FILE)
    def exec_module(self, module):
        module.__file__ = FILE
        exec(compile(open(SOURCE, encoding="utf-8").read(), FILE, "exec"), module.__dict__)
sys.meta_path.insert(0, Finder())
import pytest
sys.exit(pytest.main(ARGS))
"""


def survives(mutant: Mutant, scratch: Path) -> bool:
    """Whether a mutant's tests do not notice it; one that hangs is noticed."""
    name = "linemate." + mutant.file.removesuffix(".py").replace("/", ".")
    source = scratch / f"mutant-{abs(hash((mutant.line, mutant.what, mutant.file)))}.py"
    source.write_text(mutant.source, encoding="utf-8")
    args = ["-x", "-q", "-p", "no:cacheprovider", "-W", "ignore", *TESTS[mutant.file]]
    known = f"NAME={name!r}; FILE={str(ROOT / mutant.file)!r}; SOURCE={str(source)!r}; ARGS={args}"
    environment = {**os.environ, "HYPOTHESIS_PROFILE": "quick", "OMP_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            [sys.executable, "-c", f"{known}\n{HOOK}"],
            cwd=ROOT,
            env=environment,
            capture_output=True,
            timeout=LONGEST_S,
            check=False,
        )
    except subprocess.TimeoutExpired:
        return False
    finally:
        source.unlink()
    return done.returncode == 0


def main(argv: Sequence[str] | None = None) -> int:
    """Report; 1 if fewer than nine in ten were killed."""
    parser = argparse.ArgumentParser(prog="mutants", description="Mutation testing.")
    parser.add_argument("files", nargs="*", default=list(TESTS), metavar="FILE")
    parser.add_argument("--share", type=float, default=1.0, help="of the mutants, drawn by seed")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count() or 1)
    parser.add_argument("--bar", type=float, default=0.9, help="share to be killed")
    args = parser.parse_args(argv)
    import tempfile

    killed = total = 0
    with tempfile.TemporaryDirectory() as name, ThreadPoolExecutor(args.workers) as pool:
        for file in args.files:
            every = [m for m in mutants(file) if (m.file, m.what) not in EQUIVALENT]
            drawn = random.Random(f"{args.seed}/{file}").sample(
                every, max(1, round(args.share * len(every)))
            )
            dead = 0
            lived = pool.map(lambda m: survives(m, Path(name)), drawn)
            for mutant, alive in zip(drawn, lived, strict=True):
                dead += not alive
                if alive:
                    print(f"  survives {mutant.file}:{mutant.line}: {mutant.what}", flush=True)
            killed, total = killed + dead, total + len(drawn)
            print(f"{file}: {dead} of {len(drawn)} killed ({len(every)} there are)", flush=True)
    print(f"{killed} of {total} killed, {100.0 * killed / total:.1f} %")
    return 0 if killed >= args.bar * total else 1


if __name__ == "__main__":
    assert importlib.util.find_spec("linemate") is not None
    sys.exit(main())
