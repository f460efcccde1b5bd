"""Files of a site's commissioning: state, overlays, page.

Invariants:
- An overlay is written only after the whole configuration was checked with it.
- A power cut leaves the old file or the new one.
"""

import hashlib
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from linemate.daemon.command_line import UsageError
from linemate.daemon.commissioning import walk
from linemate.daemon.commissioning.walk import SiteState, StepName
from linemate.daemon.commissioning.whole_check import CheckedConfig, check
from linemate.daemon.config import documents, files
from linemate.daemon.config.files import UnreadableError
from linemate.daemon.operator import identify_command

FOLDER = "commission"
STATE = "progress.json"
PAGE = "page.md"
HEAD = "# Measured by `linemate commission`, step {name}; laid over the configuration.\n"
MOST_BYTES = 4_194_304


@dataclass(frozen=True, slots=True)
class Site:
    """Directory of a site.

    Attributes:
        config: path of the configuration file.
    """

    directory: Path
    config: Path

    @property
    def folder(self) -> Path:
        """Directory of what commissioning writes."""
        return self.directory / FOLDER

    def overlay(self, name: str) -> Path:
        """Return the path of an overlay."""
        return self.folder / name


def open_site(directory: Path, config: str, *, writes: bool = True) -> Site:
    """Return a site whose folder exists.

    Args:
        writes: a step is done: what it measures must not be lost for a read-only folder.

    Raises:
        UsageError: there is no configuration, or the folder cannot be made.
    """
    path = directory / config
    if not path.is_file():
        raise UsageError(f"{path}: no such file. Give the site's directory, or --config NAME")
    site = Site(directory, path)
    try:
        site.folder.mkdir(exist_ok=True)
    except OSError as error:
        raise UsageError(f"{site.folder}: {error.strerror}") from error
    if writes and not os.access(site.folder, os.W_OK | os.X_OK):
        raise UsageError(f"{site.folder}: cannot be written. Change its owner or mode")
    return site


def read_state(site: Site) -> SiteState:
    """Return how far a site has come.

    Raises:
        UsageError: the file is damaged.
    """
    path = site.folder / STATE
    if not path.exists():
        return SiteState()
    try:
        return walk.from_text(files.read_text(path, MOST_BYTES))
    except (UnreadableError, ValueError) as error:
        raise UsageError(f"{path}: {error}. Move it away to begin again") from error


def write_state(site: Site, state: SiteState) -> None:
    """Write how far a site has come."""
    identify_command.write(site.folder / STATE, walk.as_text(state))


def checked(site: Site, state: SiteState, but: StepName | None = None) -> CheckedConfig:
    """Return the configuration with all overlays of the commissioning.

    Args:
        but: a step whose overlay is left out.

    Raises:
        FileError: what is wrong.
    """
    return check(site.config, _present(site, state.overlays(but)))


def write_overlay(site: Site, state: SiteState, name: StepName, overlay: Mapping[str, Any]) -> str:
    """Check the whole configuration with an overlay, then write it; return its file's name.

    Raises:
        FileError: the configuration is refused with it. Nothing is written.
        OSError: it cannot be written.
    """
    import yaml

    file = f"{name.value}.yaml"
    body = yaml.safe_dump(dict(overlay), sort_keys=False, default_flow_style=None, width=100)
    text = HEAD.format(name=name.value) + str(body)
    candidate = site.folder / f".{file}.candidate"
    identify_command.write(candidate, text)
    try:
        check(site.config, [*_present(site, state.overlays(name)), candidate])
    finally:
        candidate.unlink(missing_ok=True)
    identify_command.write(site.overlay(file), text)
    return file


def unlisted(site: Site, state: SiteState) -> tuple[str, ...]:
    """Return the overlays that the configuration does not name yet, relative to it.

    Raises:
        FileError: the configuration cannot be read.
    """
    document = documents.read(site.config.read_bytes(), str(site.config))
    value = document.value if isinstance(document.value, dict) else {}
    listed = value.get("overlays")
    names = {str(name) for name in listed} if isinstance(listed, list) else set()
    wanted = (f"{FOLDER}/{name}" for name in state.overlays())
    return tuple(name for name in wanted if name not in names)


def digests(site: Site, state: SiteState) -> dict[str, str]:
    """Return the SHA-256 of the configuration and the overlays, by name."""
    paths = [site.config, *_present(site, state.overlays())]
    return {path.name: hashlib.sha256(path.read_bytes()).hexdigest() for path in paths}


def _present(site: Site, names: Sequence[str]) -> list[Path]:
    return [site.overlay(name) for name in names if site.overlay(name).is_file()]
