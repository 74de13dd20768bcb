"""The file formats. A reader is a subclass of `Reader` in a module of this folder, and needs no registration."""

from __future__ import annotations

import difflib
import functools
import importlib
import itertools
import pkgutil
import warnings
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, ClassVar

import numpy as np

from deepir.errors import DataError, DeepIRError, nearest
from deepir.io.guards import check_size
from deepir.io.radiometry import Radiometry

Array = np.ndarray[Any, np.dtype[Any]]
PREFERRED_NAMES = ("frames", "raw")  # names of the array that holds the frames, in order of preference
MAX_LISTED = 20  # arrays that a message lists


class Reader:
    """A file format. A subclass defines `read` or `stream`, or both.

    It may raise any exception on a damaged file: `decoding` turns it into a `DataError`.

    Attributes:
        name: Of the format.
        suffixes: Usual ones of its files.
        signatures: First bytes of its files.
        generic: True for a general format, which is tried last: a radiometric JPEG before a plain one.
        holds_raw_plane: True for pictures with the raw counts of a thermal camera.
        any_axes: True for arrays whose axes their users choose.
    """

    name: ClassVar[str]
    suffixes: ClassVar[tuple[str, ...]] = ()
    signatures: ClassVar[tuple[bytes, ...]] = ()
    generic: ClassVar[bool] = False
    holds_raw_plane: ClassVar[bool] = False
    any_axes: ClassVar[bool] = False

    def sniff(self, head: bytes, path: Path) -> bool:
        """True if this reader reads `path`, whose first 64 bytes are `head` (empty for a folder or a glob)."""
        return head.startswith(self.signatures)

    def read(self, path: Path, key: str | None) -> Array:
        """The stored array, of any shape and type; masked for a format with masks.

        Here the frames of `stream`: `DataError` if they differ in size, or exceed what the file can hold.
        """
        found: list[Array] = []
        stored, total = self.samples_file(path).stat().st_size, 0
        for piece in self.stream(path, key):
            total += piece.nbytes
            check_size(path, total, stored, compressed=True)
            found.append(piece if piece.ndim == 3 else piece[None])
            if found[-1].shape[1:] != found[0].shape[1:]:
                sizes = " and ".join(str(each.shape[1:]) for each in (found[0], found[-1]))
                raise DataError(f"{path}: frames differ in size: {sizes}")
        if not found:
            raise DataError(f"{path}: a recording without frames")
        return np.ma.concatenate(found) if any(map(np.ma.isMaskedArray, found)) else np.concatenate(found)

    def stream(self, path: Path, key: str | None) -> Iterator[Array]:
        """The stored array frame by frame, or in larger pieces."""
        yield self.read(path, key)

    def radiometries(self, path: Path, key: str | None) -> list[Radiometry | None]:
        """Conversion of counts to kelvin, of each frame where they may differ."""
        return [None]

    def samples_file(self, path: Path) -> Path:
        """The file of the samples, where a header may be named instead."""
        return path


@functools.cache
def all_readers() -> tuple[Reader, ...]:
    """Every reader in this folder, in the order of the formats' names, general ones last."""
    found: list[Reader] = []
    for each in pkgutil.iter_modules(__path__, f"{__name__}."):
        module = importlib.import_module(each.name)
        classes = [kind for kind in vars(module).values() if isinstance(kind, type)]
        found += [kind() for kind in classes if issubclass(kind, Reader) and kind.__module__ == each.name]
    return tuple(sorted(found, key=lambda reader: (reader.generic, reader.name)))


def suffixes() -> list[str]:
    """Usual suffixes of all formats."""
    return sorted({suffix for reader in all_readers() for suffix in reader.suffixes})


def find_reader(path: Path) -> Reader | None:
    """The reader that recognises the contents of a file; None if there is none.

    Raises:
        DataError: The file is missing, empty, not an ordinary file, or not readable.
    """
    with decoding(path):
        head = _head(path)
        return next((reader for reader in all_readers() if reader.sniff(head, path)), None)


@dataclass(frozen=True)
class Recording:
    """A file, a folder or a glob with its reader. Whatever cannot be read is a `DataError`."""

    path: Path
    reader: Reader
    key: str | None = None  # name of the array in a file that holds several

    @property
    def source(self) -> str:
        """The file, and the array in it that was asked for, for messages."""
        return f"{self.path}[{self.key}]" if self.key else str(self.path)

    def read(self) -> Array:
        """The stored array."""
        with decoding(self.path):
            return self.reader.read(self.path, self.key)

    def stream(self) -> Iterator[Array]:
        """The stored array in pieces: frames (h, w), or several at a time."""
        pieces = self.reader.stream(self.path, self.key)
        for count in itertools.count():
            with decoding(self.path):  # not around the loop: errors of the caller pass
                piece = next(pieces, None)
            if piece is None and count == 0:
                raise DataError(f"{self.path}: a recording without frames")
            if piece is None:
                return
            yield piece

    def radiometries(self) -> list[Radiometry | None]:
        """Radiometry of each frame; a single entry if it is that of all frames."""
        with decoding(self.path):
            found = self.reader.radiometries(self.path, self.key)
        return found if len(set(found)) > 1 else found[:1]


def opened(path: Path, key: str | None = None) -> Recording:
    """A recording of the format that its contents show; `key` names the array in a file that holds several.

    Raises:
        DataError: It is of no known format, or cannot be opened.
    """
    if (reader := find_reader(path)) is None:
        if path.suffix.lower() in suffixes():
            raise DataError(f"{path}: it does not begin as a {path.suffix} file does: damaged, or of another format")
        raise DataError(
            f"{path}: not a format that deepir reads ({', '.join(suffixes())}, or a folder of pictures). "
            "Save it as .npz with an array `frames` (frames, height, width); a file of bare samples needs "
            "data.raw.width=... data.raw.height=..."
        )
    return Recording(path, reader, key)


def samples_file(path: Path) -> Path:
    """The file that holds the samples of one: another one where a header was named."""
    reader = find_reader(path)
    return path if reader is None else reader.samples_file(path)


def can_be_frames(shape: tuple[int, ...]) -> bool:
    """Whether an array may be a frame or a stack; MATLAB's numbers and vectors are matrices too, of one row."""
    return 2 <= len(shape) <= 4 and 2 <= sum(side > 1 for side in shape) <= 3


def choose_array(shapes: Mapping[str, tuple[int, ...]], path: Path, key: str | None) -> str:
    """Name of the frames' array: `key`, else `frames`, else `raw`, else the only array with two or three dimensions.

    Args:
        shapes: Shapes of the arrays by name.
        path: The file, for messages.
        key: The user's choice.

    Raises:
        DataError: There is none, or several; the message lists the arrays.
    """
    if key is not None and key not in shapes:
        raise DataError(f"{path}: no array '{key}'; {nearest(key, shapes)}")
    for name in (key, *PREFERRED_NAMES):
        if name in shapes:
            return str(name)
    pictures = [name for name, shape in shapes.items() if can_be_frames(shape)]
    if len(pictures) != 1:
        listing = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items())[:MAX_LISTED])
        if len(shapes) > MAX_LISTED:
            listing += f" and {len(shapes) - MAX_LISTED} more"
        single = [shapes[name] for name in pictures if len(shapes[name]) == 2]
        each = len(single) > 2 and len(single) == len(pictures) and len(set(single)) == 1
        advice = "They look like a frame each: join them, as numpy.stack does, and save one. " if each else ""
        raise DataError(f"{path}: which array is meant? Give its key (data.key). {advice}Arrays: {listing or 'none'}")
    return pictures[0]


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
