"""Names of classifiers and predictors of other packages; nothing of them is imported."""

from importlib.metadata import entry_points

CLASSIFIERS = "linemate.classifiers"
PREDICTORS = "linemate.predictors"


def names() -> tuple[str, ...]:
    """Return the names of all entry points of both groups, sorted."""
    groups = (entry_points(group=CLASSIFIERS), entry_points(group=PREDICTORS))
    return tuple(sorted({entry.name for group in groups for entry in group}))


def is_plugin(name: str) -> bool:
    """Return whether a name is one of an entry point, or has the form ``module:attribute``."""
    module, _, attribute = name.partition(":")
    is_place = bool(module and attribute) and attribute.isidentifier()
    return is_place or name in names()
