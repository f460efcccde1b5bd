"""The pages: length, order, figures from stored results, changelog, sizes."""

import json
import re
import subprocess
import tomllib
from pathlib import Path

import pytest

from docs.make import (
    commission_results,
    contact_results,
    lag_results,
    movie,
    results,
    world_results,
)

ROOT = Path(__file__).resolve().parents[2]
README = ROOT / "README.md"
PAGES = sorted(
    path
    for folder in (ROOT, ROOT / "docs", ROOT / "docs/decisions", ROOT / "docs/results")
    for path in folder.glob("*.md")
)
LONGEST_LINE = 120
# A line of bytes cannot be broken: it has a word that is longer than any text's.
LONGEST_WORD = 90
FENCE = re.compile(r"^```.*?^```", re.MULTILINE | re.DOTALL)
COMMENT = re.compile(r"<!--.*?-->", re.DOTALL)
BLOCK = re.compile(r"<!-- figures (\S+): begin -->.*?<!-- figures \1: end -->", re.DOTALL)
MEASURED = re.compile(r"(?<![\w.])\d+(?:\.\d+)? ?(?:mm|mrad|N|ms|us|s|%|times|MB)\b")
# Nominal values of README: cycles of RSI.
NOMINAL = {"4 ms", "12 ms"}


def words(text: str) -> int:
    """Words as a reader counts them: what has a letter or a digit, comments left out."""
    return len(re.findall(r"\S*\w\S*", COMMENT.sub("", text)))


def test_the_readme_is_read_in_two_minutes() -> None:
    head, found, _ = README.read_text(encoding="utf-8").partition("\n## Reference\n")
    assert found
    assert words(head) <= 700


def test_the_readme_names_its_limits_before_its_commands() -> None:
    text = README.read_text(encoding="utf-8")
    order = ["What it is for", "emulators only", "Not a safety function", "## Requirements",
             "## Two commands", "## How it is connected", "## Figures", "## Reference",
             "## The paper", "Friedrich Lange, Johannes Scharrer, Gerd Hirzinger"]  # fmt: skip
    places = [text.index(each) for each in order]
    assert places == sorted(places)


def test_the_pages_for_users_are_short() -> None:
    names = ("accuracy", "performance", "reliability")
    texts = [(ROOT / f"docs/{name}.md").read_text(encoding="utf-8") for name in names]
    assert sum(map(words, texts)) <= 5000


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_no_line_is_too_long_outside_tables(page: Path) -> None:
    long = [
        number
        for number, line in enumerate(page.read_text(encoding="utf-8").splitlines(), 1)
        if len(line) > LONGEST_LINE
        and not line.startswith("|")
        and max(map(len, line.split())) <= LONGEST_WORD
    ]
    assert not long


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_figures_are_those_of_the_stored_results(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert results.filled(text) == text, "make docs-write"
    assert {found[1] for found in BLOCK.finditer(text)} <= set(results.TABLES)


def test_every_figure_of_the_readme_is_generated() -> None:
    text = FENCE.sub("", BLOCK.sub("", README.read_text(encoding="utf-8")))
    assert set(MEASURED.findall(text)) <= NOMINAL


def test_every_table_of_figures_stands_in_a_page() -> None:
    shown = {found[1] for page in PAGES for found in BLOCK.finditer(page.read_text("utf-8"))}
    assert shown == set(results.TABLES)


@pytest.mark.parametrize("name", sorted(filter(results.is_stored, results.COMMANDS)))
def test_a_stored_result_names_its_command_and_its_commit(name: str) -> None:
    file = results.FOLDER / f"{name}.json"
    record = json.loads(file.read_text(encoding="utf-8"))
    assert record["command"] == results.COMMANDS[name][0]
    assert re.fullmatch(r"[0-9a-f]{40}", record["commit"])
    assert re.fullmatch(r"\d{4}-\d\d-\d\d", record["date"])
    assert record["figures"]


def test_no_result_is_without_a_command() -> None:
    stored = {path.stem for path in results.FOLDER.glob("*.json")}
    assert stored <= set(results.COMMANDS)
    # These are measured apart from the others; their tables show what there is.
    lags = {*lag_results.COMMANDS, *lag_results.CAMPAIGNS}
    commissioned = commission_results.COMMANDS
    apart = {*world_results.COMMANDS, *contact_results.COMMANDS, *commissioned, *lags}
    assert set(results.COMMANDS) - stored <= apart


def test_the_commits_of_results_are_in_the_history() -> None:
    def git(*arguments: str) -> subprocess.CompletedProcess[str]:
        return subprocess.run(
            ["git", *arguments], cwd=ROOT, capture_output=True, text=True, check=False
        )

    if git("rev-parse", "--is-shallow-repository").stdout.strip() != "false":
        pytest.skip("no whole history here")
    for path in results.FOLDER.glob("*.json"):
        commit = json.loads(path.read_text(encoding="utf-8"))["commit"]
        assert git("merge-base", "--is-ancestor", commit, "HEAD").returncode == 0, path


def test_an_interval_needs_six_values() -> None:
    few = {"median": 1.0, "ci95": [0.0, 2.0], "worst": 2.0, "n": 5}
    assert results.spread(few) == "1 (2)"
    assert results.spread(few | {"n": 6}) == "1 [0, 2] (2)"


def test_the_changelog_keeps_its_form_and_has_the_version() -> None:
    text = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    versions = re.findall(r"^## (.+)$", text, re.MULTILINE)
    assert all(
        version == "[Unreleased]" or re.fullmatch(r"\[\d+\.\d+\.\d+\] - \d{4}-\d\d-\d\d", version)
        for version in versions
    )
    with (ROOT / "pyproject.toml").open("rb") as file:
        current = tomllib.load(file)["project"]["version"]
    assert f"[{current}]" in next(each for each in versions if each != "[Unreleased]")
    kinds = set(re.findall(r"^### (.+)$", text, re.MULTILINE))
    assert kinds <= {"Added", "Changed", "Deprecated", "Removed", "Fixed", "Security"}


def test_every_page_is_listed() -> None:
    listed = (ROOT / "docs/README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs").glob("*.md"):
        assert page.name == "README.md" or f"]({page.name})" in listed, page
    decisions = (ROOT / "docs/decisions/README.md").read_text(encoding="utf-8")
    for page in (ROOT / "docs/decisions").glob("0*.md"):
        assert f"]({page.name})" in decisions, page


def test_the_architecture_has_every_package() -> None:
    layers = (ROOT / "docs/architecture.md").read_text("utf-8").partition("\n## Processes")[0]
    for path in (*ROOT.glob("daemon/*/__init__.py"), *ROOT.glob("simulators/*/__init__.py")):
        assert re.search(rf"\b{path.parent.name}\b", layers), path.parent


@pytest.mark.parametrize(
    "page", sorted((ROOT / "docs/decisions").glob("0*.md")), ids=lambda page: page.stem
)
def test_a_decision_is_a_page_with_context_decision_and_consequences(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == ["Context", "Decision", "Consequences"]
    assert words(text) <= 400
    assert text.startswith(f"# {int(page.name[:4])}. ")


def test_the_moving_picture_is_small() -> None:
    assert 0 < movie.FILE.stat().st_size <= movie.LARGEST_BYTES


def test_every_file_that_a_page_names_exists() -> None:
    done = subprocess.run(
        ["git", "ls-files"], cwd=ROOT, capture_output=True, text=True, check=False
    )
    known = done.stdout.splitlines()
    if not known:
        pytest.skip("no git here")
    ends = {"/".join(Path(name).parts[-n:]) for name in known for n in range(1, 7)}
    missing = [
        f"{page.relative_to(ROOT)}: {name}"
        for page in PAGES
        for name in re.findall(r"`([\w/*]+\.py)`", page.read_text(encoding="utf-8"))
        if "*" not in name and name not in ends
    ]
    assert not missing
