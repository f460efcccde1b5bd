"""Check the vocabulary: words, docstring entries, empty names, and names with one meaning.

``python docs/make/vocabulary.py [--count] [FOLDER ...]`` prints each hit as ``file:line`` and ends
with 1 if there is one. Folders limit the files that are read.

Invariants:
    Words of one family of controllers stay where ``FAMILY_PLACES`` has them.
    A word counts in text and as a part of an identifier: ``told_by`` has the word ``told``.
    ``ALLOWED`` names the words that a file may use, with the reason.
"""

import argparse
import ast
import re
import shutil
import subprocess
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
SUFFIXES = (".py", ".md", ".js", ".html", ".css", ".yaml", ".toml", ".service", ".conf", ".sh")
FILES = ("Makefile", ".ci/run")

# Word or phrase: what to write instead.
WORDS = {
    "law of this file": "(nothing; say what the module does)",
    "room": "package, layer",
    "house": "package",
    "walls": "import contracts",
    "storey": "layer",
    "desk": "parameter service",
    "said": "(name what it holds)",
    "told": "(name what it holds)",
    "door": "endpoint",
    "guest": "client",
    "invite": "service window",
    "express": "fast path",
    "hasty": "fast-path mismatch",
    "glance": "quick check",
    "astray": "following error",
    "fate": "delivery status",
    "under way": "attached to a running program",
    "belief": "estimate",
    "doubt": "covariance inflation",
    "scatter": "NIS, standard deviation",
    "verdict": "decision, posterior",
    "wave": "ripple",
    "crest": "quadrature component",
    "feeling": "contact detection",
    "tape": "recorded run, trace",
    "reel": "recorded run, trace",
    "swarm": "fault campaign",
    "lived through": "ran",
    "drill": "detection benchmark",
    "put out": "excluded",
    "let back in": "readmitted",
    "inbox": "sample queue",
    "patience": "tolerance, time-out",
    "awake": "idle spinner",
    "companion": "helper thread",
    "slack": "idle time",
    "onlooker": "subscriber",
    "board": "broadcast hub",
    "outlook": "live telemetry",
    "anew": "again",
    "whoever": "anyone who, the caller",
    "nobody": "no one",
    "meanwhile": "while",
    "beside": "next to, with",
    "hence": "so",
    "held up": "delayed",
    "lest": "so that not",
    "nought": "0",
}

# Verbs of persons, for a sensor or a filter; not checked in tests.
PERSONAL = {
    "tell": "show, return, have",
    "telling": "(say what shows)",
    "deaf": "without replies",
    "believe": "assume, use",
    "bear": "withstand, carry",
    "live through": "run",
    "feel": "detect, measure",
}

# File: words that it may use, and why.
ALLOWED: dict[str, tuple[str, ...]] = {
    # The kernel's timer slack; the configuration key realtime.keep_awake.
    "daemon/operator/doctor.py": ("slack", "awake"),
    # A key of what --json prints.
    "daemon/operator/identify_command.py": ("told",),
    "tests/operator/test_identify_command.py": ("told",),
    "tests/operator/test_doctor.py": ("awake",),
    # The counters express and hasty of the robot link.
    "drivers/udp/robot_udp.py": ("express", "hasty"),
    "tests/drivers/udp/test_robot_udp.py": ("express", "hasty"),
    # The name of an object.
    "tests/protocol/test_wires_transcript.py": ("door",),
    # Keys on a wire: of the status and of the configuration.
    "daemon/cycle/cycle.py": ("astray",),
    "daemon/cycle/causes.py": ("astray",),
    "daemon/cycle/watch.py": ("astray",),
    "tests/cycle/test_cycle_faults.py": ("astray",),
    "tests/cycle/test_cycle_sessions.py": ("astray",),
    # The seed of a transcript: another name would give other draws.
    "tests/cycle/test_sensor_transcript.py": ("belief",),
    # A configuration key.
    "daemon/core/parameters.py": ("wave",),
    "docs/method.md": ("wave",),
    "simulators/harness/data/parameters/plant-floor.yaml": ("wave",),
    "simulators/harness/data/parameters/plant-floor-harsh.yaml": ("wave",),
    "daemon/core/tracking/settings.py": ("wave",),
    # A value of the output `ready`, which recordings hold.
    "daemon/core/step.py": ("under way",),
    # Configuration keys realtime.keep_awake and tracking.wave, the kernel's timer slack, and the
    # status key astray.
    "CHANGELOG.md": ("awake",),
    "docs/architecture.md": ("awake",),
    "docs/configuration.md": ("awake", "slack"),
    "docs/decisions/0006-ripple-as-a-state.md": ("wave",),
    "docs/decisions/0011-idle-spinners.md": ("awake",),
    "docs/json.md": ("astray",),
    "daemon/operator/plc/robotics_values.py": ("astray",),
    "tests/operator/test_robotics_values.py": ("astray",),
    "docs/parameters.md": ("astray", "wave"),
    "docs/performance.md": ("awake", "slack"),
    "docs/troubleshooting.md": ("awake", "astray"),
    # Parts of a car: doors, wheel house.
    "docs/mujoco.md": ("door", "house"),
    "simulators/plants/forces/switches.py": ("door",),
    # The term that the glossary explains; wall clock is a term of the field.
    "docs/glossary.md": ("slack",),
    "docs/scenarios.md": ("wall",),
    # The list itself.
    "docs/make/vocabulary.py": (*WORDS, *PERSONAL),
    # Configuration keys: keep_awake, timer_slack_ns, cycles_astray.
    "daemon/config/settings.py": ("awake", "slack"),
    "daemon/config/watch_settings.py": ("astray",),
    "daemon/service/host/realtime.py": ("awake", "slack"),
    "tests/config/test_config.py": ("slack",),
    "tests/service/test_idle_spinner.py": ("awake",),
    "tests/service/test_realtime.py": ("slack",),
    # Names of state classes and fields in recordings.
    "daemon/recording/snapshot.py": ("feeling", "verdict", "belief", "scatter"),
    "tests/recording/test_snapshot.py": ("belief",),
    # The name of a random stream: another name would give other draws.
    "simulators/lab/detection_runs.py": ("drill",),
    # The counters express and hasty of the robot link.
    "simulators/lab/faults/dst_run.py": ("hasty",),
    "tests/lab/test_bench_turnaround.py": ("express", "hasty"),
    "tests/system/test_planted_errors.py": ("hasty",),
    # The option --awake and the key keep_awake.
    "simulators/harness/main.py": ("awake",),
    "simulators/harness/demo.py": ("awake",),
    "simulators/lab/bench/bench.py": ("awake",),
    "systemd/linemated.yaml": ("awake",),
    # Keys of the status and of the configuration.
    "docs/commissioning.md": ("astray",),
    # Methods of a stream.
    "daemon/recording/bounded_mcap.py": ("tell",),
    "daemon/recording/step_file.py": ("tell",),
    "daemon/view/recorded_run.py": ("tell",),
    # The name of a test.
    "docs/fault-catalogue.md": ("wall", "tell"),
}

# Words of one family of controllers, and where they belong.
FAMILY_WORD = re.compile(
    r"\b(aipos|akorr|asipos|aspos|dil|dio|eipos|ekorr|holdon|ipoc|krl|rist|rsi|rsol|sentype)\b",
    re.IGNORECASE,
)
FAMILY_PLACES = (
    "protocol/rsi/",
    "daemon/config/controller_section.py",
    "daemon/config/rsi_section.py",
    "daemon/operator/robot/rsi_lint.py",
    # The section `rsi` of the configuration, the kinds of controllers and the command `rsi`.
    "daemon/config/config.py",
    "daemon/config/section_checks.py",
    "daemon/config/settings.py",
    "daemon/config/timeouts.py",
    "daemon/operator/main.py",
    "daemon/operator/robot/rsi_command.py",
    "daemon/service/assembly.py",
    "protocol/controller_family.py",
    # Names in older recordings.
    "daemon/operator/export_command.py",
    "daemon/recording/step_codec.py",
)
# Names that do not say what they hold or do. A part of a longer name is fine: push_sample.
VARIABLES = {"found", "made", "told", "said", "one", "took", "got", "gave", "came", "went"}
FUNCTIONS = {"take", "put", "look", "tell", "give", "hear", "say", *VARIABLES}

# File: such names that it has, and why.
NAMED: dict[str, tuple[str, ...]] = {
    # A configuration key: tracking.sway.found.
    "daemon/core/tracking/settings.py": ("found",)
}

SHORTEST_ENTRY = 4  # words of an Args or Attributes entry
CLASSES_USED_TWICE = 4

_ENTRY = re.compile(r"^\s+\*{0,2}(\w+(?:, \*{0,2}\w+)*)(?: \([^)]*\))?: (.+)$")
_SECTIONS = ("Args:", "Attributes:")
_CAMEL = re.compile(r"(?<=[a-z0-9])(?=[A-Z])")


def main() -> int:
    """Print the hits of the files that git knows.

    Returns:
        The exit code: 1 if there are any.
    """
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("folder", nargs="*", help="limits the files that are read")
    parser.add_argument("--count", action="store_true", help="print the number of hits a word")
    args = parser.parse_args()
    paths = [path for path in tracked() if is_below(path, args.folder)]
    hits = [hit for path in paths for hit in check(path, (ROOT / path).read_text("utf-8"))]
    hits += names_used_twice([path for path in paths if not path.startswith(("tests/", "docs/"))])
    if args.count:
        for what, number in Counter(what for _, _, what in hits).most_common():
            print(f"{number:5d} {what}")
    else:
        for path, line, what in hits:
            print(f"{path}:{line}: {what}")
    print(f"{len(hits)} hits in {len(paths)} files")
    return 1 if hits else 0


def tracked() -> list[str]:
    """Return the files that the check reads, relative to the repository's root."""
    listing = [shutil.which("git") or "git", "ls-files"]
    # Its arguments are constants.
    done = subprocess.run(listing, cwd=ROOT, check=True, capture_output=True, text=True)  # noqa: S603
    names = [name for name in done.stdout.splitlines() if (ROOT / name).is_file()]
    return [name for name in names if name.endswith(SUFFIXES) or name in FILES]


def is_below(path: str, folders: list[str]) -> bool:
    """Return whether a file is in one of some folders, or in any if there are none."""
    return not folders or any(path.startswith(folder.rstrip("/")) for folder in folders)


def check(path: str, text: str) -> Iterator[tuple[str, int, str]]:
    """Yield the words and the short entries of a file as (path, line, what)."""
    allowed = ALLOWED.get(path, ())
    is_neutral = path.startswith(("daemon/", "drivers/", "protocol/")) and path.endswith(".py")
    if is_neutral and not path.startswith(FAMILY_PLACES):
        for match in FAMILY_WORD.finditer(text):
            line = text.count("\n", 0, match.start()) + 1
            yield path, line, f"{match[0]}: a word of one family, in neutral code"
    plain = _CAMEL.sub(" ", text).replace("_", " ").lower()
    words = WORDS if path.startswith("tests/") else WORDS | PERSONAL
    for word, instead in words.items():
        if word in allowed:
            continue
        pattern = r"(?<![a-z])" + word.replace(" ", r"\s+") + r"s?(?![a-z])"
        for match in re.finditer(pattern, plain):
            yield path, plain.count("\n", 0, match.start()) + 1, f"'{word}': write {instead}"
    if path.endswith(".py"):
        yield from short_entries(path, text)
        if not path.startswith("tests/"):
            yield from empty_names(path, text)


def empty_names(path: str, text: str) -> Iterator[tuple[str, int, str]]:
    """Yield the functions, arguments and variables whose name says nothing."""
    for node in ast.walk(ast.parse(text)):
        name, words = "", VARIABLES
        match node:
            case ast.FunctionDef(name=name) | ast.AsyncFunctionDef(name=name):
                words = FUNCTIONS
            case ast.arg(arg=name) | ast.Name(id=name, ctx=ast.Store()):
                pass
            case ast.Attribute(attr=name, ctx=ast.Store()):
                pass
        if name.strip("_") in words and name not in NAMED.get(path, ()):
            what = "verb and object" if words is FUNCTIONS else "what it holds"
            yield path, getattr(node, "lineno", 1), f"name '{name}': write {what}"


def short_entries(path: str, text: str) -> Iterator[tuple[str, int, str]]:
    """Yield the Args and Attributes entries that have too few words to add anything."""
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            continue
        lines = (ast.get_docstring(node, clean=True) or "").splitlines()
        inside, begin = False, getattr(node, "lineno", 1)
        for number, line in enumerate(lines):
            if not line.startswith(" "):
                inside = line in _SECTIONS
            entry = _ENTRY.match(line) if inside else None
            if entry is None or _goes_on(lines, number):
                continue
            if len(entry[2].split()) < SHORTEST_ENTRY:
                yield path, begin + number, f"entry '{entry[1]}' says too little: delete it"


def _goes_on(lines: list[str], number: int) -> bool:
    """Return whether the next line belongs to the same entry."""
    after = lines[number + 1] if number + 1 < len(lines) else ""
    return after.startswith("        ")


def names_used_twice(paths: list[str]) -> Iterator[tuple[str, int, str]]:
    """Yield class names in two modules beyond the allowed number, and module names in two."""
    classes: dict[str, list[str]] = {}
    modules: dict[str, list[str]] = {}
    for path in paths:
        if not path.endswith(".py"):
            continue
        for node in ast.parse((ROOT / path).read_text("utf-8")).body:
            if isinstance(node, ast.ClassDef):
                classes.setdefault(node.name, []).append(path)
        if Path(path).stem not in {"__init__", "main", "settings"}:
            modules.setdefault(Path(path).name, []).append(path)
    twice = {name: where for name, where in classes.items() if len(where) > 1}
    if len(twice) > CLASSES_USED_TWICE:
        for name, where in twice.items():
            yield where[0], 1, f"class {name} is also in {', '.join(where[1:])}"
    for name, where in modules.items():
        if len(where) > 1:
            yield where[0], 1, f"module {name} is also in {', '.join(where[1:])}"


if __name__ == "__main__":
    sys.exit(main())
