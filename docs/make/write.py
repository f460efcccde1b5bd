"""Write the generated files: tables of pages, schema, manuals, completions, bill of materials.

Invariants:
- A page keeps its head. The generated part begins below the line of ``reference.MADE``.
"""

import argparse
import json
import sys
from collections.abc import Iterator
from pathlib import Path

import shtab

from docs.make import manual, notebook, programs, python_reference, reference, results, sbom, states
from linemate.daemon.config import config
from linemate.daemon.config.files import DAEMON_DATA

DOCS = Path(__file__).resolve().parents[1]


def pages() -> Iterator[tuple[Path, str]]:
    """Yield every generated file and its text."""
    named = ("../README.md", "accuracy.md", "commission-steps.md", "contact.md",
             "fault-catalogue.md", "interop.md", "mujoco.md", "performance.md", "production.md",
             "reliability.md", "world.md")  # fmt: skip
    for page in ((DOCS / name).resolve() for name in named):
        yield page, results.filled(page.read_text(encoding="utf-8"))
    yield states.PAGE, states.drawn(states.PAGE.read_text(encoding="utf-8"))
    packages = sbom.closure()
    yield DOCS / "sbom.cdx.json", sbom.bill(packages)
    yield DOCS.parent / "requirements.txt", sbom.requirements(packages)
    yield DAEMON_DATA / "linemated.schema.json", json.dumps(config.schema(), indent=1) + "\n"
    for name, generated in (
        ("configuration.md", reference.configuration_page()),
        ("parameters.md", reference.parameters_page()),
        ("scenarios.md", reference.scenarios_page()),
        ("task.md", reference.task_page()),
        ("python.md", python_reference.page()),
    ):
        path = DOCS / name
        kept = path.read_text(encoding="utf-8").partition(reference.MADE)[0]
        yield path, kept + reference.MADE + "\n" + generated
    for example in sorted(notebook.EXAMPLES.glob("*.py")):
        yield example.with_suffix(".ipynb"), notebook.text(example)
    yield DOCS / "man/linemated.yaml.5", manual.configuration_page()
    for parser, number, what, more in programs.every():
        yield DOCS / f"man/{parser.prog}.{number}", manual.program_page(parser, number, what, more)
        _complete_files(parser)
        for shell, name in (("bash", f"{parser.prog}.bash"), ("zsh", f"_{parser.prog}")):
            yield DOCS / "completion" / name, shtab.complete(parser, shell).rstrip() + "\n"


def _complete_files(parser: argparse.ArgumentParser) -> None:
    """Let shells complete files and folders where an option takes them."""
    kinds = {"FILE": shtab.FILE, "PATH": shtab.FILE, "DIR": shtab.DIRECTORY}
    for action in parser._actions:  # noqa: SLF001 - argparse has no public name for it
        if action.metavar in kinds:
            action.complete = kinds[action.metavar]  # type: ignore[attr-defined]
        if isinstance(action, argparse._SubParsersAction):  # noqa: SLF001
            for inner in action.choices.values():
                _complete_files(inner)


def main() -> int:
    """Write the generated files, or report those that are out of date."""
    parser = argparse.ArgumentParser(prog="python -m docs.make.write", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing, name stale files")
    parser.add_argument("names", nargs="*", help="names of files; all without")
    args = parser.parse_args()
    stale = []
    for path, text in pages():
        if args.names and path.name not in args.names:
            continue
        if path.exists() and path.read_text(encoding="utf-8") == text:
            continue
        stale.append(str(path.relative_to(DOCS.parent)))
        if not args.check:
            path.parent.mkdir(exist_ok=True)
            path.write_text(text, encoding="utf-8")
    if stale and args.check:
        print("out of date, run `make docs-write`:", *stale, file=sys.stderr)
    return 1 if stale and args.check else 0


if __name__ == "__main__":
    sys.exit(main())
