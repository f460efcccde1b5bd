"""Manual pages in roff, from the programs' parsers and the settings' classes."""

import argparse
import re
from collections import Counter
from collections.abc import Iterable, Iterator

from docs.make import reference

Sub = argparse._SubParsersAction  # noqa: SLF001 - argparse has no public name for it


def escaped(text: str) -> str:
    """Return text for roff."""
    text = text.replace("\\", "\\e").replace("-", "\\-").replace("``", "")
    return re.sub(r"^([.'])", r"\\&\1", text, flags=re.MULTILINE)


def head(name: str, number: int, what: str) -> list[str]:
    """Return the first lines of a page."""
    return [
        '.\\" Made by `make docs-write`.',
        f'.TH {name.upper()} {number} "" linemate "linemate"',
        ".SH NAME",
        f"{escaped(name)} \\- {escaped(what)}",
    ]


def program_page(
    parser: argparse.ArgumentParser, number: int, what: str, more: dict[str, list[str]]
) -> str:
    """Return a program's page.

    Args:
        number: of the manual's section.
        what: one line about the program.
        more: further sections, a paragraph a line; one with a tab has a term before it.
    """
    lines = head(parser.prog, number, what)
    lines += [".SH SYNOPSIS", *_synopsis(parser)]
    lines += [".SH DESCRIPTION", *_paragraphs(more.pop("DESCRIPTION", []))]
    commands = list(_commands(parser))
    shared = _shared(commands)
    if commands:
        lines.append(".SH COMMANDS")
        for command, about in commands:
            lines += [".SS " + escaped(command.prog.partition(" ")[2] + _arguments(command))]
            lines += [escaped(about[:1].upper() + about[1:] + ("" if about.endswith(".") else "."))]
            lines += _options(action for action in _own(command) if _key(action) not in shared)
    own = [*_options(_own(parser)), *_options(shared.values())]
    if own:
        title = "OPTIONS OF COMMANDS THAT ASK A DAEMON" if shared else "OPTIONS"
        lines += [f".SH {title}", *own]
    for title, paragraphs in more.items():
        lines += [f".SH {title}", *_paragraphs(paragraphs)]
    return "\n".join(lines) + "\n"


def _synopsis(parser: argparse.ArgumentParser) -> list[str]:
    if any(isinstance(action, Sub) for action in parser._actions):  # noqa: SLF001
        return [f".B {escaped(parser.prog)}", ".I COMMAND", "[options]"]
    return [f".B {escaped(parser.prog)}", escaped(_arguments(parser).strip())]


def _arguments(parser: argparse.ArgumentParser) -> str:
    """Return the arguments after the command's name, in short."""
    parts = []
    for action in parser._actions:  # noqa: SLF001
        if isinstance(action, (argparse._HelpAction, Sub)):  # noqa: SLF001
            continue
        if action.option_strings:
            if action.required:
                parts.append(f"{action.option_strings[0]} {_metavar(action)}")
            continue
        name = _metavar(action)
        name += " ..." if action.nargs in {"+", "*"} else ""
        parts.append(f"[{name}]" if action.nargs in {"?", "*"} else name)
    return "".join(f" {part}" for part in parts)


def _metavar(action: argparse.Action) -> str:
    if action.choices is not None and action.metavar is None:
        return "|".join(map(str, action.choices))
    return str(action.metavar or action.dest.upper())


def _commands(
    parser: argparse.ArgumentParser, about: str = ""
) -> Iterator[tuple[argparse.ArgumentParser, str]]:
    """Yield the commands at the leaves with their help."""
    for action in parser._actions:  # noqa: SLF001
        if isinstance(action, Sub):
            texts = {choice.dest: choice.help or "" for choice in action._choices_actions}  # noqa: SLF001
            for name, inner in action.choices.items():
                below = list(_commands(inner))
                yield from below or [(inner, texts.get(name, about))]


def _own(parser: argparse.ArgumentParser) -> Iterator[argparse.Action]:
    """Yield the options of a parser, without --help."""
    for action in parser._actions:  # noqa: SLF001
        if action.option_strings and not isinstance(action, argparse._HelpAction):  # noqa: SLF001
            yield action


def _key(action: argparse.Action) -> tuple[str, ...]:
    return (*action.option_strings, str(action.metavar), str(action.help))


def _shared(
    commands: list[tuple[argparse.ArgumentParser, str]],
) -> dict[tuple[str, ...], argparse.Action]:
    """Return the options that most commands have."""
    keyed = [(_key(action), action) for command, _ in commands for action in _own(command)]
    count = Counter(key for key, _ in keyed)
    return {key: action for key, action in keyed if count[key] > len(commands) / 2}


def _options(actions: Iterable[argparse.Action]) -> list[str]:
    lines = []
    for action in actions:
        value = "" if action.nargs == 0 else f" \\fI{escaped(_metavar(action))}\\fR"
        names = ", ".join(f"\\fB{escaped(name)}\\fR" for name in action.option_strings)
        lines += [".TP", names + value, escaped(_help(action)) or "\\&"]
    return lines


def _help(action: argparse.Action) -> str:
    text = (action.help or "") % {"default": action.default} if action.help else ""
    return text[:1].upper() + text[1:] + ("." if text and not text.endswith(".") else "")


def _paragraphs(paragraphs: list[str]) -> list[str]:
    lines: list[str] = []
    for paragraph in paragraphs:
        term, tab, text = paragraph.partition("\t")
        if tab:
            lines += [".TP", f"\\fB{escaped(term)}\\fR", escaped(text)]
        elif paragraph.startswith("  "):
            lines += [".PP", ".nf", ".RS", escaped(paragraph.strip("\n")), ".RE", ".fi"]
        else:
            lines += [".PP", escaped(paragraph)]
    return lines


def configuration_page() -> str:
    """linemated.yaml(5)."""
    lines = head("linemated.yaml", 5, "configuration of the linemate daemon")
    lines += [
        ".SH DESCRIPTION",
        *_paragraphs(
            [
                "One YAML file a daemon. Paths are relative to it; a bare name may be a file that"
                " comes with linemate. Lengths are in m, angles in rad, times in s unless a name"
                " says otherwise. What is left out keeps its default; a key that is not known, a"
                " key given twice and a value that readers of YAML read differently are errors.",
                "linemated --config FILE --check reports every error of the file and of those it"
                " names, as file:line:column: key: what; linemated --schema prints the JSON schema"
                " for editors.",
            ]
        ),
    ]
    for section in reference.sections():
        listed = list(reference.keys(section))
        if not listed:
            continue
        lines.append(f".SH {escaped(section.name or 'THE FILE')}")
        lines.append(escaped(reference.meaning(section)))
        for key in listed:
            facts = [key.kind, f"default {key.default}"] + ([key.allowed] if key.allowed else [])
            lines += [".TP", f"\\fB{escaped(key.name)}\\fR ({escaped(', '.join(facts))})"]
            lines.append(escaped(key.meaning) or "\\&")
    lines += [".SH SEE ALSO", escaped("linemated(8), linemate(1)")]
    return "\n".join(lines) + "\n"
