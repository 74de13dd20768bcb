"""Paths as users give them."""

from __future__ import annotations

import os
from pathlib import Path


def expanded(path: str | os.PathLike[str]) -> Path:
    """The path with `~` and `~user` replaced by the home folder; unchanged if there is no such user."""
    return Path(os.path.expanduser(path))  # noqa: PTH111 - Path's own raises


def is_file(path: str | os.PathLike[str]) -> bool:
    """True for a file; False, too, for a name that is too long."""
    return os.path.isfile(path)  # noqa: PTH113 - Path's own raises


def printable(text: str) -> str:
    r"""A text in one line, such as a file's name; control characters are escaped.

    >>> printable("a\n\x1b[31m.npz")
    'a\\n\\x1b[31m.npz'
    """
    if text.isprintable():  # the map of a page has a million characters
        return text
    return "".join(each if each.isprintable() else each.encode("unicode_escape").decode("ascii") for each in text)
