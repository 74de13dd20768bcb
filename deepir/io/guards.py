"""Guards of input and output: files, their bytes and their size, grey pictures, and packages that a format needs."""

from __future__ import annotations

import functools
import importlib
import logging
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import IO, Any, Self

import numpy as np

from deepir.errors import DataError

GIB = 2**30  # bytes
MAX_ARRAY_BYTES = 8 * GIB  # largest array that is read at once
MAX_COMPRESSION_RATIO = 3000  # bytes out of one byte: deflate reaches 1032, LZW about 2700
LOSSY_TOLERANCE = 0.02  # difference of the channels that a lossy codec may give a grey pixel, share of the range
MAX_COLOURED = 0.01  # share of the pixels of a grey picture that may be coloured: marks and text
MAX_COLOURED_LOSSY = 0.05  # the same where a lossy codec spreads their colours over its blocks
UNCHECKED_BYTES = GIB // 16  # size up to which a claim is not checked: an empty mask may be that compressible
SEARCH_BYTES = 2**20  # read at once while bytes are sought

Array = np.ndarray[Any, np.dtype[Any]]
log = logging.getLogger("deepir")
#: Rows and columns of pictures in which colours count: what lies outside is cropped.
_judged: ContextVar[tuple[slice, slice]] = ContextVar("judged", default=(slice(None), slice(None)))


def import_optional(library: str, extra: str, what: str) -> Any:
    """Import a library that only some formats need.

    Args:
        library: Name of the module.
        extra: Extra of deepir that installs it.
        what: File or option that needs it, for the message.

    Returns:
        The module.

    Raises:
        DataError: It is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(library)
    except ImportError:
        raise DataError(
            f"{what}: this needs {library}, which is not installed: pip install 'deepir[{extra}]'"
        ) from None


def check_size(path: Path, declared: int, stored: int, *, compressed: bool = False, at_once: bool = True) -> None:
    """Refuse implausible sizes before memory is allocated.

    Args:
        path: The file, for messages.
        declared: Bytes of data that the file declares.
        stored: Bytes of the file.
        compressed: True: the data may be larger than the file.
        at_once: True: the data are read at once, and may not exceed `MAX_ARRAY_BYTES`.

    Raises:
        DataError: The file cannot hold the data, or they are too large.
    """
    most = max(UNCHECKED_BYTES, MAX_COMPRESSION_RATIO * stored) if compressed else stored
    if not 0 <= declared <= most:
        raise DataError(f"{path}: damaged or truncated: it declares {declared:,} bytes of data but holds {stored:,}")
    if at_once and declared > MAX_ARRAY_BYTES:
        raise DataError(
            f"{path}: {declared / GIB:.1f} GiB of data; at most {MAX_ARRAY_BYTES // GIB} GiB are read at once. "
            "Split the file."
        )


@functools.cache
def warn_once(message: str) -> None:
    """Log a warning, however often the file is read."""
    log.warning("%s", message)


@contextmanager
def judging_colours_in(box: Sequence[int] | None) -> Iterator[None]:
    """A context in which `to_grey` judges only the part [y0, y1, x0, x1] of a picture; None: all of it."""
    part = (slice(None), slice(None)) if box is None or len(box) != 4 else (slice(*box[:2]), slice(*box[2:]))
    token = _judged.set(part)
    try:
        yield
    finally:
        _judged.reset(token)


def masked(frames: Array, lost: Array) -> Array:
    """Frames that are masked where samples are lost besides, if any are."""
    return np.ma.masked_array(frames, np.ma.getmaskarray(frames) | lost) if lost.any() else frames


def to_grey(pixels: Array, path: Path, *, tolerance: float = 0.0) -> Array:
    """The one channel of a grey picture that was stored in colour.

    Args:
        pixels: (..., C), C = 1 to 4; alpha (C = 2 or 4) is dropped.
        path: The file, for messages.
        tolerance: Difference of the channels of a grey pixel, as a share of the range: of lossy codecs.

    Returns:
        (...); masked where few pixels are coloured (a marker or text).

    Raises:
        DataError: More pixels are coloured.
    """
    channels = pixels.shape[-1]
    first = pixels[..., 0]
    if channels < 3:
        return first
    wide = pixels[..., :3].astype(np.int32 if pixels.dtype.kind in "iu" else pixels.dtype)
    most = tolerance * np.iinfo(pixels.dtype).max if tolerance else 0
    coloured = np.ptp(wide, axis=-1) > most
    if coloured[(..., *_judged.get())].mean() > (MAX_COLOURED_LOSSY if tolerance else MAX_COLOURED):
        raise DataError(
            f"{path}: a colour picture. A palette picture carries no radiometry: colours cannot be turned "
            "back into flux. Export raw 16-bit data (TIFF or PNG), or at least a white-hot grey picture. If only a "
            "bar or a legend at its edge is in colour, take it off with data.crop. If it is the visible picture beside "
            f"a thermal one, name the thermal ones with a glob, such as '{path.parent}/*_T.jpg'"
        )
    return masked(first, coloured)


class FileBytes:
    """A file as `bytes`, as far as slices, `len` and `find` go; a context manager.

    Unlike a memory map it may lie on a file that is cut meanwhile: that is a `DataError`, and no signal.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self._file = path.open("rb")
        self._size = path.stat().st_size

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._file.close()

    def __len__(self) -> int:
        return self._size

    def __getitem__(self, part: slice) -> bytes:
        start, stop, _ = part.indices(self._size)
        self._file.seek(start)
        found = self._file.read(max(0, stop - start))
        if len(found) < stop - start:
            raise DataError(f"{self.path}: truncated while it was read")
        return found

    def find(self, what: bytes, start: int) -> int:
        """First place at or after `start` where these bytes are; -1: nowhere."""
        if self[start : start + len(what)] == what:  # the usual place of a next frame
            return start
        while start < self._size:
            at = self[start : start + SEARCH_BYTES].find(what)
            if at >= 0:
                return start + at
            start += SEARCH_BYTES - len(what) + 1
        return -1


def stream_planes(path: Path, dtype: np.dtype[Any], offset: int, shape: Sequence[int], gap: int = 0) -> Iterator[Array]:
    """The arrays `shape[1:]` of an array in C order; `offset`: bytes before its first sample, `gap`: between arrays."""
    with path.open("rb") as file:
        file.seek(offset)
        yield from read_planes(file, path, dtype, shape, gap)


def read_planes(
    stream: IO[bytes], path: Path, dtype: np.dtype[Any], shape: Sequence[int], gap: int = 0
) -> Iterator[Array]:
    """The arrays `shape[1:]` of an array in C order.

    Args:
        stream: At the first sample.
        path: The file, for messages.
        dtype: Of a sample, byte order included.
        shape: Of the whole array.
        gap: Bytes between arrays.

    Raises:
        DataError: The stream ends before the array does.
    """
    size = math.prod(shape[1:]) * dtype.itemsize
    for number in range(shape[0]):
        data = stream.read(size)
        if len(data) < size:
            raise DataError(f"{path}: truncated: it ends within frame {number} of {shape[0]}")
        yield np.frombuffer(data, dtype).reshape(shape[1:])
        stream.read(gap)
