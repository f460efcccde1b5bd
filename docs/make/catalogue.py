"""Figures of the fault catalogue: ``python -m docs.make.catalogue`` runs its rows, prints JSON.

A test gives each figure and its bound to the fixture ``within``, which writes them as properties of
a JUnit report.
"""

import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any
from xml.etree import ElementTree as ET

ROOT = Path(__file__).resolve().parents[2]
FILES = ("tests/system/test_catalogue.py", "tests/system/test_late_and_lost_telegrams.py")
_NAME = re.compile(r"test_((?:[a-z][0-9]+_)+)(\w+)")


def rows(report: str) -> list[dict[str, Any]]:
    """Return, by test and figure, how often it was measured, the one nearest its bound, and that.

    Args:
        report: JUnit XML that pytest wrote for ``FILES``.
    """
    figures: dict[tuple[str, str, str], list[tuple[float, float]]] = {}
    # The report is that of our own pytest.
    for case in ET.fromstring(report).iter("testcase"):  # noqa: S314
        named = _NAME.match(case.attrib["name"])
        if named is None:
            continue
        for each in case.iter("property"):
            row = named[1].upper().rstrip("_").replace("_", ", ")
            key = row, named[2].replace("_", " "), each.attrib["name"]
            measured, most = map(float, each.attrib["value"].split())
            figures.setdefault(key, []).append((measured, most))
    keys = "row", "test", "what", "measured", "most"
    return [
        dict(zip(keys, (*key, *max(values, key=lambda pair: pair[0] / pair[1])), strict=True))
        | {"count": len(values)}
        for key, values in figures.items()
    ]


def main() -> int:
    """Run the rows and print their figures; 1 if one does not hold."""
    with tempfile.TemporaryDirectory() as folder:
        report = Path(folder) / "report.xml"
        command = [sys.executable, "-m", "pytest", "-q", *FILES, f"--junit-xml={report}"]
        command += ["-o", "junit_family=xunit1"]
        # The words are constants of this file.
        done = subprocess.run(command, check=False, cwd=ROOT, stdout=sys.stderr)  # noqa: S603
        json.dump({"rows": rows(report.read_text(encoding="utf-8"))}, sys.stdout, indent=1)
    return done.returncode


if __name__ == "__main__":
    sys.exit(main())
