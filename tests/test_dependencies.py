"""Dependencies: every imported package is declared, and a cell needs no package of an extra."""

import ast
import importlib
import importlib.metadata
import sys
import tomllib
from collections.abc import Iterator
from pathlib import Path

import pytest
from packaging.requirements import Requirement

from docs.make import sbom

ROOT = Path(__file__).resolve().parents[1]
FOLDERS = ("protocol", "drivers", "daemon", "simulators")
# Import names that are not the package's name.
PACKAGES = {
    "can": "python-can",
    "foxglove": "foxglove-sdk",
    "google": "protobuf",
    "mujoco": "mujoco-core",
    "pinocchio": "pin",
    "yaml": "pyyaml",
    "zenoh": "eclipse-zenoh",
}


def imported(folder: str) -> Iterator[tuple[str, str]]:
    """Yield (package, file) of each import of a third-party package."""
    for path in sorted((ROOT / folder).rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_bytes())):
            match node:
                case ast.Import():
                    names = [alias.name for alias in node.names]
                case ast.ImportFrom(module=str(module), level=0):
                    names = [module]
                case _:
                    names = []
            for name in names:
                top = name.partition(".")[0]
                if top not in sys.stdlib_module_names and top != "linemate":
                    package = sbom.canonical(PACKAGES.get(top, top))
                    yield package, str(path.relative_to(ROOT))


def declared(*extras: str) -> set[str]:
    project = sbom.project()
    lists = [project["dependencies"], *(project["optional-dependencies"][name] for name in extras)]
    return {sbom.canonical(Requirement(text).name) for texts in lists for text in texts}


@pytest.mark.parametrize("folder", FOLDERS)
def test_every_package_that_is_imported_is_declared(folder: str) -> None:
    extras = {
        "daemon": ["fleet", "foxglove", "plc", "ros2"],
        "simulators": ["cluster", "demo", "mujoco", "plc"],
    }.get(folder, [])
    known = declared(*extras)
    missing = [(package, path) for package, path in imported(folder) if package not in known]
    assert not missing


def test_every_package_that_a_cell_installs_is_imported() -> None:
    used = {package for folder in FOLDERS for package, _ in imported(folder)}
    # python-can's slcan interface imports pyserial.
    assert declared() - used <= {"pyserial"}


def test_every_declared_package_has_a_tried_version() -> None:
    lines = (ROOT / "constraints.txt").read_text(encoding="utf-8").splitlines()
    pinned = {sbom.canonical(line.partition("==")[0]) for line in lines if "==" in line}
    with (ROOT / "pyproject.toml").open("rb") as file:
        extras = tomllib.load(file)["project"]["optional-dependencies"]
    assert declared(*extras) <= pinned


def test_the_development_extra_holds_every_other_extra() -> None:
    extras = sbom.project()["optional-dependencies"]
    for name, texts in extras.items():
        assert set(texts) <= set(extras["dev"]), name


def test_the_bill_names_what_a_cell_installs_with_licence_and_version() -> None:
    packages = sbom.closure()
    assert declared() <= set(packages)
    assert not {"matplotlib", "rich", "pytest"} & set(packages)
    for name, package in packages.items():
        assert package.version == importlib.metadata.version(name)
        assert sbom.licence(package)


def test_a_command_of_the_demo_names_the_extra_that_is_missing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for name in [name for name in sys.modules if name.startswith("linemate.simulators.harness")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rich.console", None)
    main = importlib.import_module("linemate.simulators.harness.main").main
    assert main(["demo"]) == 2
    assert "package rich is missing" in capsys.readouterr().err


def test_every_folder_with_code_is_installed() -> None:
    listed = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["setuptools"]["packages"]
    folders = {"linemate"} | {
        ".".join(("linemate", *path.parent.relative_to(ROOT).parts))
        for folder in FOLDERS
        for path in (ROOT / folder).rglob("__init__.py")
    }
    assert set(listed) == folders
