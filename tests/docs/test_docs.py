"""The pages: their links lead somewhere, what is made is in step, and what they show runs.

Invariants:
    A block ``sh`` runs line by line in one shell, in a scratch folder of a running daemon.
    Of long commands (``make``, ``linemate-sim``) only the command line is parsed.
    A block ``sh host`` is parsed only: by bash, and by the programs' own parsers.
"""

import json
import os
import re
import select
import shlex
import shutil
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import pytest
from daemon_process import DaemonProcess

from linemate.daemon.operator import main as operator
from linemate.daemon.service import main as service
from linemate.simulators.harness import main as harness

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted(
    path
    for folder in (ROOT, ROOT / "docs", ROOT / "docs/decisions", ROOT / "docs/results")
    for path in folder.glob("*.md")
)
ASSIGNMENT = re.compile(r"[A-Za-z_]+=")
LINK = re.compile(r"\[[^\]]*\]\(([^)\s]+)\)")
FENCE = re.compile(r"^```(\S*)[ ]?(.*?)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PARSERS = {
    "linemate": operator.parser(),
    "linemated": service.parser(),
    "linemate-sim": harness._parser(),
}
LINEMATE_SIM = (sys.executable, "-m", "linemate.simulators.harness.main")
JUDGED = 'linemate() { command linemate "$@" || [ "$1" = status ]; }'
"""A machine that is delayed makes the cell's status degraded: that is no fault of the page."""

COSTLY = ("make", "linemate-sim")


@dataclass(frozen=True)
class Block:
    page: str
    line: int
    text: str
    host: bool

    def __str__(self) -> str:
        return f"{self.page}:{self.line}"


def blocks() -> Iterator[Block]:
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        for found in FENCE.finditer(text):
            if found[1] == "sh":
                line = text[: found.start()].count("\n") + 1
                # What stands for a name of the reader's own cannot be run either.
                host = found[2].strip() == "host" or "..." in found[3]
                yield Block(page.name, line, found[3], host)


BLOCKS = list(blocks())


def commands(text: str) -> list[list[str]]:
    """The simple commands of a block, as words, without what a shell would do with them."""
    joined = text.replace("\\\n", " ")
    found = []
    for line in joined.splitlines():
        lexer = shlex.shlex(line, posix=True, punctuation_chars="|&;<>()")
        lexer.whitespace_split = True
        words: list[str] = []
        for word in [*lexer, ";"]:
            if word and set(word) <= set("|&;"):
                if words:
                    found.append(words)
                words = []
            elif words or not ASSIGNMENT.match(word):
                words.append(word)
    return found


def program(words: list[str]) -> str:
    return words[0].rpartition("/")[2].removeprefix("$")


def parsed(words: list[str]) -> None:
    """Try a command line on the parser of its program."""
    ends = [i for i, word in enumerate(words) if word in {"<", ">", ">>"}]
    # What is shown in brackets may be left out, and must fit all the same.
    given = [word.strip("[]") for word in words[1 : min(ends, default=len(words))]]
    try:
        PARSERS[program(words)].parse_args(given)
    except SystemExit as ended:
        if ended.code != 0:
            raise AssertionError(words) from ended


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    for target in LINK.findall(FENCE.sub("", text)):
        if target.startswith(("http://", "https://", "mailto:")):
            continue
        name, _, anchor = target.partition("#")
        there = page.parent / name if name else page
        assert there.exists(), target
        if anchor:
            heads = re.findall(r"^#+ (.+)$", there.read_text(encoding="utf-8"), re.MULTILINE)
            anchors = {re.sub(r"[^\w\- ]", "", head).strip().lower().replace(" ", "-")
                       for head in heads}  # fmt: skip
            assert anchor in anchors, (target, anchors)


def test_what_is_made_is_in_step_with_the_program() -> None:
    pytest.importorskip("shtab", reason="shtab makes the completions; it is in the extra dev")
    done = subprocess.run(
        [sys.executable, "-m", "docs.make.write", "--check"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr


@pytest.mark.skipif(shutil.which("groff") is None, reason="no groff here")
@pytest.mark.parametrize("page", sorted((ROOT / "docs/man").iterdir()), ids=lambda p: p.name)
def test_a_manual_page_is_understood_and_whole(page: Path) -> None:
    done = subprocess.run(
        ["groff", "-man", "-Tutf8", "-ww", "-z", str(page)],
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    text = page.read_text(encoding="utf-8")
    assert all(f".SH {part}" in text for part in ("NAME", "DESCRIPTION", "SEE ALSO"))


@pytest.mark.skipif(shutil.which("bash") is None, reason="no bash here")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["linemate", "par"], {"param"}),
        (["linemate", "param", "de"], {"describe"}),
        (["linemate", "status", "--wa"], {"--watch"}),
        (["linemate", "record", "st"], {"start", "stop"}),
        (["linemate", "replay", "command-pr"], {"command-protocol.md"}),
        (["linemated", "--ch"], {"--check"}),
        (["linemated", "--config", "command-pr"], {"command-protocol.md"}),
        (["linemate-sim", "ca"], {"campaign"}),
    ],
    ids=" ".join,
)
def test_bash_completes_what_can_be_typed(words: list[str], expected: set[str]) -> None:
    script = ROOT / "docs/completion" / f"{words[0]}.bash"
    function = f"_shtab_{words[0].replace('-', '_')}"
    asked = (
        f"source {script}; COMP_WORDS=({' '.join(words)}); COMP_CWORD={len(words) - 1};"
        f" COMP_LINE='{' '.join(words)}'; {function}; printf '%s\\n' \"${{COMPREPLY[@]}}\""
    )
    done = subprocess.run(
        ["bash", "-c", asked], capture_output=True, text=True, check=True, cwd=ROOT / "docs"
    )
    assert set(done.stdout.split()) == expected, done.stderr


ZSH = """PS1=; fpath=({folder} $fpath); autoload -U compinit; compinit -u -D
unsetopt zle_bracketed_paste; shown() {{ print -r -- "<$BUFFER>" }}; zle -N shown
bindkey '^I' complete-word; bindkey '^Xs' shown; print BEG''IN
"""


@pytest.mark.skipif(shutil.which("zsh") is None, reason="no zsh here")
@pytest.mark.parametrize(
    ("typed", "expected"),
    [
        ("linemate par", ["<linemate param >"]),
        ("linemate param de", ["<linemate param describe >"]),
        ("linemate status --wa", ["<linemate status --watch >"]),
        ("linemate record st", ["start", "stop"]),
        ("linemated --ch", ["<linemated --check >"]),
        ("linemate-sim ca", ["<linemate-sim campaign >"]),
    ],
)
def test_zsh_completes_what_can_be_typed(typed: str, expected: list[str]) -> None:
    ours, its = os.openpty()
    shell = subprocess.Popen(["zsh", "-f", "-i"], stdin=its, stdout=its, stderr=its)
    os.close(its)
    text = ""

    def until(words: list[str]) -> None:
        nonlocal text
        while not all(word in text for word in words):
            assert select.select([ours], [], [], 30.0)[0], text
            text += os.read(ours, 4096).decode()

    try:
        os.write(ours, ZSH.format(folder=ROOT / "docs/completion").encode())
        until(["BEGIN"])
        text = ""
        os.write(ours, f"{typed}\t\x18s".encode())
        until(expected)
    finally:
        shell.kill()
        shell.wait()
        os.close(ours)


@pytest.fixture(scope="module")
def scratch(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A folder with a running daemon's files, as the pages speak of them."""
    folder = tmp_path_factory.mktemp("cell")
    text = (
        "task: wheel.yaml\nrsi: {port: 0}\nstate: .\n"
        "recording: {directory: ., at_start: true}\ncommand: {socket: command.sock}\n"
    )
    with DaemonProcess(folder, text) as daemon:
        host, port = daemon.robot()
        # A busy machine answers late for minutes, and no page speaks of that.
        emulated = (
            f"robot_target: [{host}, {port}]\nwait_answered: 1000000\n"
            "controller: {timeout: 1000000}\n"
        )
        (folder / "emulator.yaml").write_text(emulated, encoding="utf-8")
        with subprocess.Popen(
            [*LINEMATE_SIM, "emulator", "--config", str(folder / "emulator.yaml")],
            stdout=subprocess.DEVNULL,
        ) as emulator:
            try:
                daemon.status_once(lambda status: status["health"] == "healthy", 60.0)
                yield folder
            finally:
                emulator.terminate()


def environment(folder: Path) -> dict[str, str]:
    path = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
    home = {"HOME": str(folder), "XDG_CONFIG_HOME": str(folder / "config")}
    return {**os.environ, **home, "PATH": path, "LINEMATE_SOCKET": str(folder / "command.sock")}


# A block may need what an earlier one of its page made: a page runs as a whole, or not at all.
SHOWN = {page.name: [b for b in BLOCKS if b.page == page.name and not b.host] for page in PAGES}


@pytest.mark.row
@pytest.mark.parametrize("page", [name for name, its_blocks in SHOWN.items() if its_blocks])
def test_every_command_shown_runs(page: str, scratch: Path) -> None:
    for block in SHOWN[page]:
        _run(block, scratch)


def _run(block: Block, scratch: Path) -> None:
    cheap = []
    for line in block.text.replace("\\\n", " ").splitlines():
        shown = commands(line)
        if any(program(words) in COSTLY for words in shown):
            for words in shown:
                if program(words) == "make":
                    subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, check=True)
                elif program(words) in PARSERS:
                    parsed(words)
        else:
            cheap.append(line)
    done = subprocess.run(
        ["bash", "-euo", "pipefail", "-c", "\n".join([JUDGED, *cheap])],
        cwd=scratch,
        env=environment(scratch),
        capture_output=True,
        text=True,
        timeout=60.0,
        check=False,
    )
    assert done.returncode == 0, (str(block), block.text, done.stdout, done.stderr)


def test_every_key_of_a_status_is_documented_and_no_other(scratch: Path) -> None:
    done = subprocess.run(
        ["linemate", "status", "--json"],
        env=environment(scratch),
        capture_output=True,
        text=True,
        check=False,
    )
    page = (ROOT / "docs/json.md").read_text(encoding="utf-8").partition("## `status`")[2]
    firsts = [line.split("|")[1] for line in page.splitlines() if line.startswith("| `")]
    documented = {name for first in firsts for name in re.findall(r"`(\w+)`", first)}
    assert set(json.loads(done.stdout)) == documented


@pytest.mark.parametrize("block", [block for block in BLOCKS if block.host], ids=str)
def test_every_command_for_the_cell_is_understood(block: Block) -> None:
    read = subprocess.run(
        ["bash", "-n"], input=block.text, text=True, capture_output=True, check=False
    )
    assert read.returncode == 0, read.stderr
    for words in commands(block.text):
        if program(words) in PARSERS:
            parsed(words)
        if program(words) == "make":
            subprocess.run(["make", "-n", *words[1:]], cwd=ROOT, check=True, capture_output=True)
