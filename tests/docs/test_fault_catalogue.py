"""docs/fault-catalogue.md has every row and names tests that exist."""

import re
from pathlib import Path

from docs.make import catalogue

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/fault-catalogue.md"
ROWS = (
    *(f"S{n}" for n in range(1, 13)),
    *(f"R{n}" for n in range(1, 10)),
    *(f"P{n}" for n in range(1, 15)),
    *(f"M{n}" for n in range(1, 11)),
    *(f"X{n}" for n in range(1, 21)),
)


def page() -> str:
    return PAGE.read_text(encoding="utf-8")


def test_every_row_of_the_catalogue_is_answered_by_a_test_or_argued() -> None:
    rows = page().partition("## Figures of the rows")[0]
    lines = {m[1]: m[0] for m in re.finditer(r"^\| ([SRPMX]\d+) \|.*$", rows, re.MULTILINE)}
    assert tuple(lines) == ROWS
    for name, line in lines.items():
        assert "::test_" in line or "**argued**" in line, name


def test_every_test_that_is_named_is_there() -> None:
    named = set(re.findall(r"`([\w/]+\.py)::(test_\w+)`", page()))
    assert len(named) > 60
    missing = [f"{path}::{test}" for path, test in sorted(named) if not is_there(path, test)]
    assert not missing


def is_there(path: str, test: str) -> bool:
    """Whether a test file defines a test."""
    file = ROOT / "tests" / path
    return file.exists() and f"def {test}(" in file.read_text(encoding="utf-8")


REPORT = """<testsuite>
<testcase name="test_s5_s8_damage_is_refused[flip]"><properties>
<property name="added, mm" value="0.9 2"/><property name="added, mm" value="0.2 1"/>
</properties></testcase>
<testcase name="test_s5_s8_damage_is_refused[nan]"><properties>
<property name="added, mm" value="0.1 1"/></properties></testcase>
<testcase name="test_without_a_row"/>
</testsuite>"""


def test_of_the_figures_of_a_test_the_one_nearest_to_its_bound_is_shown() -> None:
    assert catalogue.rows(REPORT) == [
        {"row": "S5, S8", "test": "damage is refused", "what": "added, mm", "measured": 0.9,
         "most": 2.0, "count": 3}
    ]  # fmt: skip
