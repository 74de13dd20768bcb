"""PGM, 8 and 16 bit, plain (P2) or not (P5), with comments, of one or many pictures.

Layout after https://netpbm.sourceforge.net/doc/pgm.html.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import check_size, stack_frames
from deepir.io.readers import Array

SUFFIXES = (".pgm",)
#: Magic number, width, height and largest value, with comments between them, and the white space before the samples.
HEADER = re.compile(rb"\s*(P[25])" + 3 * rb"(?:\s|#[^\n]*\n)+(\d+)" + rb"\s", re.DOTALL)
END = re.compile(rb"\s*\Z")


def sniff(head: bytes, path: Path) -> bool:
    """The magic number, and white space or a comment after it."""
    return re.match(rb"P[25][\s#]", head) is not None


def read(path: Path, key: str | None) -> Array:
    """All pictures (N, h, w), uint8 or uint16.

    Raises:
        DataError: They differ in size, or the last one is not whole.
    """
    return stack_frames(stream(path, key), path)


def stream(path: Path, key: str | None) -> Iterator[Array]:
    """Picture after picture (h, w)."""
    data, at = path.read_bytes(), 0
    while END.match(data, at) is None:
        header = HEADER.match(data, at)
        if header is None:
            raise DataError(f"{path}: damaged: no picture begins at byte {at}")
        width, height, largest = (int(number) for number in header.groups()[1:])
        if not 0 < largest < 2**16:
            raise DataError(f"{path}: damaged: its largest value is {largest}")
        dtype = np.dtype("u1" if largest < 2**8 else ">u2")
        at = header.end()
        if header[1] == b"P2":
            check_size(path, 2 * width * height - 1, len(data) - at)
            words = data[at:].split(None, width * height)
            if len(words) < width * height:
                raise DataError(f"{path}: truncated: {len(words)} samples of {width * height}")
            samples = np.array(words[: width * height], int).astype(dtype)
            at = len(data) - (len(words[-1]) if len(words) > width * height else 0)
        else:
            check_size(path, dtype.itemsize * width * height, len(data) - at)
            samples = np.frombuffer(data, dtype, width * height, at)
            at += samples.nbytes
        yield samples.reshape(height, width).astype(dtype.newbyteorder("="))
