"""The errors that a user may see."""

from __future__ import annotations

import difflib
from collections.abc import Iterable


class DeepIRError(Exception):
    """An error that the user can fix: the message says what is wrong, where, and what to do (exit code 2)."""


class ConfigError(DeepIRError):
    """A configuration is wrong; the message names the key's path."""


class DataError(DeepIRError):
    """A file or its contents cannot be used; the message names the file."""


class SolverError(DeepIRError):
    """The solve failed (NaN, divergence); the last good state is kept (exit code 1)."""


def nearest(name: str, allowed: Iterable[str]) -> str:
    """A hint on a misspelt name: the closest allowed one, and all that are allowed.

    >>> nearest("tvv", ["tv", "ridge"])
    "did you mean 'tv'? Allowed: ridge, tv"
    """
    names = sorted(allowed)
    close = difflib.get_close_matches(name, names, n=1)
    hint = f"did you mean '{close[0]}'? Allowed" if close else "allowed"
    return f"{hint}: {', '.join(names) if names else 'nothing'}"
