"""Software bill of materials (CycloneDX 1.6) of what ``make install`` installs.

Read from the metadata of the installed packages. ``python -m docs.make.write`` stores the bill as
``docs/sbom.cdx.json`` and its versions as ``requirements.txt``.

Invariants:
- The bill names every package that ``linemate`` requires without an extra, with its licence.
- ``requirements.txt`` is complete: ``make install`` installs it with ``--no-deps``.
"""

import json
import re
import tomllib
from collections.abc import Iterable, Mapping
from importlib.metadata import Distribution, distribution
from pathlib import Path
from typing import Any

from packaging.requirements import Requirement

PYPROJECT = Path(__file__).resolve().parents[2] / "pyproject.toml"

# filterpy imports matplotlib in its plot functions only; nothing here calls one. Without it and
# what it requires an installation is smaller by 100 MB.
UNUSED = {"filterpy": {"matplotlib"}}

HEAD = """\
# What `make install` installs, with --no-deps. Made from pyproject.toml, constraints.txt and the
# installed metadata by `make docs-write`; docs/sbom.cdx.json is the same list with licences.
"""


def canonical(name: str) -> str:
    """Return a package's name as package indexes compare it (PEP 503)."""
    return re.sub(r"[-_.]+", "-", name).lower()


def project() -> dict[str, Any]:
    """Return the table ``project`` of pyproject.toml."""
    with PYPROJECT.open("rb") as file:
        table: dict[str, Any] = tomllib.load(file)["project"]
    return table


def names(requirements: Iterable[str], unused: Iterable[str] = ()) -> list[str]:
    """Return the packages that requirements name here, without extras and unused ones."""
    wanted = (Requirement(text) for text in requirements)
    return sorted(
        canonical(item.name)
        for item in wanted
        if (item.marker is None or item.marker.evaluate({"extra": ""}))
        and canonical(item.name) not in unused
    )


def required(package: Distribution) -> list[str]:
    """Return the packages that one installed package requires here."""
    return names(package.requires or [], UNUSED.get(canonical(package.name), ()))


def closure() -> dict[str, Distribution]:
    """Return all packages that linemate requires, directly or not, by name."""
    packages: dict[str, Distribution] = {}
    pending = names(project()["dependencies"])
    while pending:
        name = pending.pop()
        if name not in packages:
            packages[name] = distribution(name)
            pending += required(packages[name])
    return dict(sorted(packages.items()))


def requirements(packages: Mapping[str, Distribution]) -> str:
    """Return the text of ``requirements.txt``."""
    return HEAD + "".join(f"{name}=={package.version}\n" for name, package in packages.items())


def bill(packages: Mapping[str, Distribution]) -> str:
    """Return the bill as CycloneDX JSON, without a date: the text depends on the packages alone."""
    own = project()
    reference = f"pkg:pypi/{own['name']}@{own['version']}"
    direct = names(own["dependencies"])
    requires = {reference: direct} | {_reference(p): required(p) for p in packages.values()}
    document = {
        "bomFormat": "CycloneDX",
        "specVersion": "1.6",
        "version": 1,
        "metadata": {
            "component": {
                "type": "application",
                "bom-ref": reference,
                "name": own["name"],
                "version": own["version"],
                "licenses": [{"expression": own["license"]}],
            }
        },
        "components": [_component(package) for package in packages.values()],
        "dependencies": [
            {"ref": name, "dependsOn": [_reference(packages[other]) for other in others]}
            for name, others in requires.items()
        ],
    }
    return json.dumps(document, indent=1) + "\n"


def licence(package: Distribution) -> str:
    """Return the licence that a package declares: an SPDX expression, or its classifier's words."""
    data = package.metadata
    classifiers = data.get_all("Classifier") or []
    named = [text.rpartition(" :: ")[2] for text in classifiers if text.startswith("License ::")]
    stated = (data.get("License") or "").strip().partition("\n")[0]
    return data.get("License-Expression") or ", ".join(named) or stated or "not declared"


def _component(package: Distribution) -> dict[str, Any]:
    stated = licence(package)
    is_expression = "License-Expression" in package.metadata
    return {
        "type": "library",
        "bom-ref": _reference(package),
        "name": canonical(package.name),
        "version": package.version,
        "purl": _reference(package),
        "licenses": [{"expression": stated} if is_expression else {"license": {"name": stated}}],
    }


def _reference(package: Distribution) -> str:
    return f"pkg:pypi/{canonical(package.name)}@{package.version}"
