"""Guards of input and output: files, their size, and packages that a format needs."""

from __future__ import annotations

import functools
import importlib
import logging
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError

GIB = 2**30  # bytes
MAX_ARRAY_BYTES = 8 * GIB  # largest array that is read at once
MAX_COMPRESSION_RATIO = 3000  # bytes out of one byte: deflate reaches 1032, LZW about 2700
LOSSY_TOLERANCE = 0.02  # difference of the channels that a lossy codec may give a grey pixel, share of the range
MAX_COLOURED = 0.01  # share of the pixels of a grey picture that may be coloured: marks and text
MAX_COLOURED_LOSSY = 0.05  # the same where a lossy codec spreads their colours over its blocks
UNCHECKED_BYTES = GIB // 16  # size up to which a claim is not checked: an empty mask may be that compressible


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


log = logging.getLogger("deepir")

#: Rows and columns of pictures in which colours count: what lies outside is cropped.
_judged: ContextVar[tuple[slice, slice]] = ContextVar("judged", default=(slice(None), slice(None)))


class ColourError(DataError):
    """A picture is in colour."""


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


def masked(frames: np.ndarray[Any, Any], lost: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """Frames that are masked where samples are lost besides, if any are."""
    return np.ma.masked_array(frames, np.ma.getmaskarray(frames) | lost) if lost.any() else frames


def to_grey(pixels: np.ndarray[Any, Any], path: Path, *, tolerance: float = 0.0) -> np.ndarray[Any, Any]:
    """The one channel of a grey picture that was stored in colour.

    Args:
        pixels: (..., C), C = 1 to 4; alpha (C = 2 or 4) is dropped.
        path: The file, for messages.
        tolerance: Difference of the channels of a grey pixel, as a share of the range: of lossy codecs.

    Returns:
        (...); masked where few pixels are coloured (a marker or text).

    Raises:
        ColourError: More pixels are coloured.
    """
    channels = pixels.shape[-1]
    first = pixels[..., 0]
    if channels < 3:
        return first
    wide = pixels[..., :3].astype(np.int32 if pixels.dtype.kind in "iu" else pixels.dtype)
    most = tolerance * np.iinfo(pixels.dtype).max if tolerance else 0
    coloured = np.ptp(wide, axis=-1) > most
    if coloured[(..., *_judged.get())].mean() > (MAX_COLOURED_LOSSY if tolerance else MAX_COLOURED):
        raise ColourError(
            f"{path}: a colour picture. A palette picture carries no radiometry: colours cannot be turned "
            "back into flux. Export raw 16-bit data (TIFF or PNG), or at least a white-hot grey picture. If only a "
            "bar or a legend at its edge is in colour, take it off with data.crop"
        )
    return masked(first, coloured)
