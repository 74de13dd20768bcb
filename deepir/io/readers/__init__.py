"""The file formats, one module each.

A reader is a module in one of the sub-folders `arrays`, `pictures` and `thermal`, or in this folder, with

    SUFFIXES: tuple[str, ...]                       usual suffixes of its files
    def sniff(head: bytes, path: Path) -> bool      recognises a file by its first 64 bytes, not its name
    def read(path: Path, key: str | None) -> Array  the stored array, of any shape and type

It needs no registration. It may also have

    def stream(path: Path, key: str | None) -> Iterator[Array]  the same frame by frame, or in larger pieces
    def radiometry(path: Path, key: str | None) -> Radiometry | None  conversion of counts to kelvin
    def radiometries(path: Path, key: str | None) -> list[Radiometry | None]  of each frame, where they may differ
    def samples_file(path: Path) -> Path  the file of the samples, where a header may be named instead

    ANY_AXES = True                                     arrays whose axes their users choose

for recordings larger than the memory, and for radiometric ones. A reader of a general format sets `GENERIC = True`
and is tried last, so that a radiometric JPEG is recognised before a plain one. A reader may raise any exception on a
damaged file: `decoding` turns it into a `DataError`.
"""

from __future__ import annotations

import difflib
import functools
import importlib
import pkgutil
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np

from deepir.errors import DataError, DeepIRError
from deepir.io.radiometry import Radiometry

Array = np.ndarray[Any, np.dtype[Any]]


class Reader(Protocol):
    """The interface of a reader."""

    __name__: str
    SUFFIXES: tuple[str, ...]

    def sniff(self, head: bytes, path: Path) -> bool:
        """True if this reader reads `path`, whose first bytes are `head` (empty for a folder or a glob)."""

    def read(self, path: Path, key: str | None) -> Array:
        """The stored array; masked for a format with masks."""


@functools.cache
def all_readers() -> tuple[Reader, ...]:
    """Every reader in this folder and its sub-folders, in the order of the formats' names, general ones last."""
    found = pkgutil.walk_packages(__path__, f"{__name__}.")
    names = sorted((each.name for each in found if not each.ispkg), key=lambda name: name.rpartition(".")[2])
    readers = [importlib.import_module(name) for name in names]
    return tuple(cast(list[Reader], sorted(readers, key=lambda reader: getattr(reader, "GENERIC", False))))


def suffixes() -> list[str]:
    """Usual suffixes of all formats."""
    return sorted({suffix for reader in all_readers() for suffix in reader.SUFFIXES})


def find_reader(path: Path) -> Reader | None:
    """The reader that recognises the contents of a file; None if there is none.

    Raises:
        DataError: The file is missing, empty, not an ordinary file, or not readable.
    """
    with decoding(path):
        head = _head(path)
        return next((reader for reader in all_readers() if reader.sniff(head, path)), None)


def samples_file(path: Path) -> Path:
    """The file that holds the samples of one: another one where a header was named."""
    own = getattr(find_reader(path), "samples_file", None)
    return own(path) if own else path


def read(path: Path, key: str | None = None) -> Array:
    """The stored array of a file, a folder or a glob.

    Args:
        path: The file, folder or glob.
        key: Name of the array in a file that holds several.

    Raises:
        DataError: The file cannot be read.
    """
    reader = find_reader(path)
    if reader is None:
        raise DataError(
            f"{path}: not a format that deepir reads ({', '.join(suffixes())}, or a folder of pictures). "
            "Save it as .npz with an array `frames` (frames, height, width); a file of bare samples needs "
            "data.raw.width=... data.raw.height=..."
        )
    with decoding(path):
        return reader.read(path, key)


def stream(path: Path, key: str | None = None) -> Iterator[Array]:
    """The stored array in pieces: frames (h, w), or several at a time.

    Args:
        path: The file, folder or glob.
        key: Name of the array in a file that holds several.

    Raises:
        DataError: As `read`, when the damaged piece is reached.
    """
    own = getattr(find_reader(path), "stream", None)
    pieces = own(path, key) if own else iter([read(path, key)])
    empty = True
    while True:
        with decoding(path):  # not around the loop: errors of the caller pass
            piece = next(pieces, None)
        if piece is None:
            break
        yield piece
        empty = False
    if empty:
        raise DataError(f"{path}: a recording without frames")


def radiometry(path: Path, key: str | None = None) -> Radiometry | None:
    """Radiometry of a file, or of one of its arrays; None if it has none.

    Raises:
        DataError: As `read`.
    """
    own = getattr(find_reader(path), "radiometry", None)
    with decoding(path):
        return own(path, key) if own else None


def radiometries(path: Path, key: str | None = None) -> list[Radiometry | None]:
    """Radiometry of each frame of a file; a single entry if it is that of all frames.

    Raises:
        DataError: As `read`.
    """
    own = getattr(find_reader(path), "radiometries", None)
    with decoding(path):
        found = own(path, key) if own else [radiometry(path, key)]
    return found if len(set(found)) > 1 else found[:1]


@contextmanager
def decoding(path: Path) -> Iterator[None]:
    """Turn whatever a decoder raises inside into a `DataError` that names the file; hide its warnings."""
    try:
        with warnings.catch_warnings():
            for category in (UserWarning, RuntimeWarning):
                warnings.simplefilter("ignore", category)
            yield
    except DeepIRError:
        raise
    except FileNotFoundError as error:
        raise DataError(f"{path}: no such file or folder{_neighbours(path)}") from error
    except PermissionError as error:
        raise DataError(f"{path}: no permission to read it") from error
    except MemoryError as error:
        raise DataError(f"{path}: does not fit into this machine's memory") from error
    # Decoders raise almost anything on damaged files (struct.error, zlib.error, KeyError ...).
    except Exception as error:
        reason = " ".join(str(error).split()) or type(error).__name__
        raise DataError(f"{path}: cannot be read; it is damaged or truncated ({reason[:200]})") from error


def is_glob(path: Path) -> bool:
    """True for a pattern such as `frames/*.png` that is not the name of an existing file."""
    return any(letter in str(path) for letter in "*?[") and not path.exists()


def _head(path: Path) -> bytes:
    if path.is_dir() or is_glob(path):
        return b""
    # A pipe or a device would block, or never end.
    if path.exists() and not path.is_file():
        raise DataError(f"{path}: not an ordinary file")
    with path.open("rb") as file:
        head = file.read(64)
    if not head:
        raise DataError(f"{path}: the file is empty")
    return head


def _neighbours(path: Path) -> str:
    folder = path.parent
    if not folder.is_dir():
        return f" (there is no folder {folder})"
    close = difflib.get_close_matches(path.name, [entry.name for entry in folder.iterdir()], n=3)
    return f"; did you mean {' or '.join(repr(name) for name in close)}?" if close else ""
