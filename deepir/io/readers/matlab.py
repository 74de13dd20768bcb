"""MATLAB's `.mat`, versions 5 to 7: named arrays whose last axis is that of the frames. Version 7.3 is HDF5."""

from __future__ import annotations

import math
import struct
import zlib
from pathlib import Path

import numpy as np
import scipy.io

from deepir.errors import DataError
from deepir.io.guards import FileBytes, check_size
from deepir.io.readers import Array, Reader, can_be_frames, choose_array

MATLAB_5 = b"MATLAB 5.0 MAT-file"
#: First number of a matrix in version 4, little- or big-endian: 1000 M + 10 P + T, P the type of values, T zero.
MATLAB_4 = tuple(
    struct.pack(f"{order}I", machine + 10 * kind) for order, machine in (("<", 0), (">", 1000)) for kind in range(6)
)
#: Bytes per value of MATLAB's numeric classes; cells, structures and function handles are not frames.
BYTES_PER_VALUE = {"single": 4, "double": 8} | {f"{sign}int{n}": n // 8 for sign in ("", "u") for n in (8, 16, 32, 64)}
HEADER_BYTES = 128  # before the first element
TAG_BYTES = 8  # of an element: type and length
MATRIX, COMPRESSED = 14, 15  # types of elements: an array; one that is packed by zlib
NUMERIC_CLASSES = range(6, 16)  # of arrays: double to uint64
NUMERIC_TYPES = (1, 2, 3, 4, 5, 6, 7, 9, 12, 13)  # of values: int8 to uint32, single, double, int64, uint64
COMPLEX_FLAG = 0x08  # in the second byte of an array's flags
HEAD_BYTES = 2**16  # of an array, in which its flags, sizes and name are


class Mat(Reader):
    """Arrays of numbers."""

    name = "mat"
    suffixes = (".mat",)
    any_axes = True

    def sniff(self, head: bytes, path: Path) -> bool:
        """The text at the head of a file; of version 4 the suffix and the head of a matrix."""
        return head.startswith(MATLAB_5) or (path.suffix.lower() == ".mat" and head[:4] in MATLAB_4)

    def read(self, path: Path, key: str | None) -> Array:
        """The array, (h, w) or (N, h, w); MATLAB stores (h, w, N)."""
        with path.open("rb") as file:
            if not file.read(len(MATLAB_5)).startswith(MATLAB_5):
                raise DataError(
                    f"{path}: a file of MATLAB 4, which is not read; load it in MATLAB and save it with '-v7'"
                )
        _check_elements(path)
        with path.open("rb") as file:
            known = {name: (shape, kind) for name, shape, kind in scipy.io.whosmat(file)}
            numbers = {each: shape for each, (shape, kind) in known.items() if kind in BYTES_PER_VALUE}
            if key is None and not any(map(can_be_frames, numbers.values())) and set(known) - set(numbers):
                found = ", ".join(f"{name} ({kind})" for name, (_, kind) in known.items()) or "nothing"
                raise DataError(
                    f"{path}: holds no array of frames but {found}; join its frames into one, in MATLAB: "
                    "frames = cat(3, c{:}); save('burst.mat', 'frames')"
                )
            name = choose_array(numbers, path, key)
            shape, kind = known[name]
            check_size(path, math.prod(shape) * BYTES_PER_VALUE[kind], path.stat().st_size, compressed=True)
            file.seek(0)
            array: Array = scipy.io.loadmat(file, variable_names=[name])[name]
        if array.shape != tuple(shape):
            raise DataError(f"{path}: damaged: {name} is {array.shape} where its header says {shape}")
        return np.moveaxis(array, -1, 0) if array.ndim > 2 else array


def _check_elements(path: Path) -> None:
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
    """Check the flags of an array and the type of its values, by the first bytes of its element without the tag."""
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
        raise DataError(f"{path}: damaged: an array of numbers whose values are of type {kind}, which no number has")


def _tag(head: bytes, order: str, at: int) -> tuple[int, int, int]:
    """Type of an element, the place of its first byte, and its length; up to four bytes are packed into the tag."""
    kind, length = struct.unpack_from(f"{order}II", head, at)
    if kind >> 16:
        return kind & 0xFFFF, at + TAG_BYTES // 2, kind >> 16
    return kind, at + TAG_BYTES, length
