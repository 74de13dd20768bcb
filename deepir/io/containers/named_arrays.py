"""Named arrays of a file, and the elements of MATLAB's."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Mapping
from pathlib import Path

from deepir.errors import DataError, nearest
from deepir.io.containers.file_bytes import FileBytes

PREFERRED_NAMES = ("frames", "raw")  # names of the array that holds the frames, in order of preference

MAX_LISTED = 20  # arrays that a message lists
HEADER_BYTES = 128  # before the first element
TAG_BYTES = 8  # of an element: type and length
MATRIX, COMPRESSED = 14, 15  # types of elements: an array; one that is packed by zlib
NUMERIC_CLASSES = range(6, 16)  # of arrays: double to uint64
NUMERIC_TYPES = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13)  # of values: int8 to uint32, single, double, int64, uint64
COMPLEX_FLAG = 0x08  # in the second byte of an array's flags
HEAD_BYTES = 2**16  # of an array, in which its flags, sizes and name are


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
        raise DataError(
            f"{path}: which array is meant? Give its key (data.key). {advice}Arrays: {listing or 'none'}"
        )
    return pictures[0]


def check_elements(path: Path) -> None:
    """Raise `DataError` if an array of numbers in a file has values of no numeric type, or complex ones."""
    with FileBytes(path) as data:
        order = "<" if data[126:128] == b"IM" else ">"
        at = HEADER_BYTES
        while at + TAG_BYTES <= len(data):
            kind, length = struct.unpack(f"{order}II", data[at : at + TAG_BYTES])
            at += TAG_BYTES
            head = data[at : at + min(length, HEAD_BYTES)]
            if kind == COMPRESSED:
                head = zlib.decompressobj().decompress(data[at : at + length], HEAD_BYTES)
                kind = struct.unpack(f"{order}I", head[:4])[0]
                head = head[TAG_BYTES:]
            if kind == MATRIX:
                _check_array(head, order, path)
            at += length


def _check_array(head: bytes, order: str, path: Path) -> None:
    """Check the flags of an array and the type of its values.

    Args:
        head: The first bytes of the array's element, without its tag.
        order: Byte order, as `struct` has it.
        path: The file, for messages.
    """
    if len(head) < 2 * TAG_BYTES:
        return  # an empty array
    (flags,) = struct.unpack_from(f"{order}I", head, TAG_BYTES)
    if flags & 0xFF not in NUMERIC_CLASSES:
        return
    if flags >> 8 & COMPLEX_FLAG:
        raise DataError(f"{path}: holds complex numbers; frames are integers or real numbers")
    at = 2 * TAG_BYTES
    for _ in ("sizes", "name"):
        _, start, length = _tag(head, order, at)
        at = start + -(-length // 8) * 8 if start == at + TAG_BYTES else at + TAG_BYTES
    kind, _, _ = _tag(head, order, at)
    if kind not in NUMERIC_TYPES:
        raise DataError(
            f"{path}: damaged: an array of numbers whose values are of type {kind}, which no number has"
        )


def _tag(head: bytes, order: str, at: int) -> tuple[int, int, int]:
    """Type of an element, the place of its first byte, and its length; up to four bytes are packed into the tag."""
    kind, length = struct.unpack_from(f"{order}II", head, at)
    if kind >> 16:
        return kind & 0xFFFF, at + TAG_BYTES // 2, kind >> 16
    return kind, at + TAG_BYTES, length
