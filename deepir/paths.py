"""Paths as users give them."""

from __future__ import annotations

import os
from pathlib import Path


def expanded(path: str | os.PathLike[str]) -> Path:
    """The path with `~` and `~user` replaced by the home folder; as it stands where there is no such user."""
    return Path(os.path.expanduser(path))  # noqa: PTH111 - Path's own raises


def is_file(path: str | os.PathLike[str]) -> bool:
    """Whether it is a file; a name that is too long for one is none."""
    return os.path.isfile(path)  # noqa: PTH113 - Path's own raises
