"""Checks of all readers: plausible sizes, and colours that carry numbers."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError

GIB = 2**30  # bytes
MAX_ARRAY_BYTES = 8 * GIB  # largest array that is read at once
MAX_COMPRESSION_RATIO = 3000  # bytes out of one byte: deflate reaches 1032, LZW about 2700
UNCHECKED_BYTES = GIB // 4  # size up to which a claim is not checked: an empty mask may be that compressible


def check_size(
    path: Path, declared: int, stored: int, *, compressed: bool = False, at_once: bool = True
) -> None:
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
        raise DataError(
            f"{path}: damaged or truncated: it declares {declared:,} bytes of data but holds {stored:,}"
        )
    if at_once and declared > MAX_ARRAY_BYTES:
        raise DataError(
            f"{path}: {declared / GIB:.1f} GiB of data; at most {MAX_ARRAY_BYTES // GIB} GiB are read at once. "
            "Split the file."
        )


def stack_frames(frames: Iterable[np.ndarray[Any, Any]], path: Path) -> np.ndarray[Any, Any]:
    """Frames (N, h, w) of single frames (h, w) of a file.

    Raises:
        DataError: There are none, they differ in size, or exceed what the file can hold.
    """
    found: list[np.ndarray[Any, Any]] = []
    stored, total = path.stat().st_size, 0
    for frame in frames:
        total += frame.nbytes
        check_size(path, total, stored, compressed=True)
        found.append(frame)
        if frame.shape != found[0].shape:
            raise DataError(f"{path}: frames differ in size: {found[0].shape} and {frame.shape}")
    if not found:
        raise DataError(f"{path}: a recording without frames")
    return np.ma.stack(found) if any(map(np.ma.isMaskedArray, found)) else np.stack(found)


def to_grey(pixels: np.ndarray[Any, Any], path: Path) -> np.ndarray[Any, Any]:
    """The one channel of a grey picture that was stored in colour.

    Args:
        pixels: (..., C), C = 1 to 4; alpha (C = 2 or 4) is dropped.
        path: The file, for messages.

    Returns:
        (...); masked where up to 1 % of the pixels are coloured (a marker or text).

    Raises:
        DataError: More pixels are coloured.
    """
    channels = pixels.shape[-1]
    first = pixels[..., 0]
    if channels < 3:
        return first
    coloured = (first != pixels[..., 1]) | (first != pixels[..., 2])
    if coloured.mean() > 0.01:
        raise DataError(
            f"{path}: a colour picture. A palette picture carries no radiometry: colours cannot be turned "
            "back into flux. Export raw 16-bit data (TIFF or PNG), or at least a white-hot grey picture."
        )
    return np.ma.masked_array(first, coloured) if coloured.any() else first
