"""NumPy's `.npy`: one array. Nothing is unpickled."""

from __future__ import annotations

import io
import math
from collections.abc import Iterator
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format

from deepir.errors import DataError
from deepir.io.containers.file_bytes import read_planes
from deepir.io.guards import check_size
from deepir.io.readers import Array

ANY_AXES = True
SUFFIXES = (".npy",)
MAX_HEADER_BYTES = 10_000  # that NumPy parses
Header = tuple[tuple[int, ...], bool, np.dtype[Any]]


def sniff(head: bytes, path: Path) -> bool:
    """NumPy's magic string."""
    return head.startswith(npy_format.MAGIC_PREFIX)


def read(path: Path, key: str | None) -> Array:
    """The stored array.

    Raises:
        DataError: It holds pickled objects, or has a wrong length.
    """
    with path.open("rb") as file:
        return read_stream(file, path, path.stat().st_size)


def stream(path: Path, key: str | None) -> Iterator[Array]:
    """Frame after frame (h, w) of an array (N, h, w), else the array."""
    with path.open("rb") as file:
        yield from stream_frames(file, path, path.stat().st_size)


def read_header(stream: IO[bytes], path: Path) -> Header:
    """Shape, Fortran order and type; `stream` then stands at the first byte of the data."""
    version = npy_format.read_magic(stream)
    # Version 3 only adds the names of record fields outside Latin-1, and records are no frames.
    readers = {(1, 0): (2, npy_format.read_array_header_1_0), (2, 0): (4, npy_format.read_array_header_2_0)}
    if version not in readers:
        raise DataError(f"{path}: an array of format {version}; only plain arrays of numbers can be read")
    size, parse = readers[version]
    length = stream.read(size)
    if int.from_bytes(length, "little") > MAX_HEADER_BYTES:  # NumPy would take memory for it first
        raise DataError(f"{path}: damaged: its header claims {int.from_bytes(length, 'little'):,} bytes")
    return parse(io.BytesIO(length + stream.read(int.from_bytes(length, "little"))))


def read_stream(stream: IO[bytes], path: Path, size: int) -> Array:
    """One array from a stream.

    Args:
        stream: At its beginning.
        path: The file, for messages.
        size: Length of the stream, bytes.
    """
    shape, fortran, dtype = _check(stream, path, size)
    declared = math.prod(shape) * dtype.itemsize
    # To the end, not only `declared` bytes: a zip checks its checksum there.
    data = stream.read()
    if len(data) != declared:
        raise DataError(f"{path}: damaged: {len(data):,} bytes where the header says {declared:,}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")


def stream_frames(stream: IO[bytes], path: Path, size: int) -> Iterator[Array]:
    """Frame after frame (h, w) of an array (N, h, w) from a stream, else the array; arguments as in `read_stream`."""
    begin = stream.tell()
    shape, fortran, dtype = _check(stream, path, size, at_once=False)
    plane = tuple(side for side in shape[1:] if side != 1)  # of (N, h, w), (N, 1, h, w) or (N, h, w, 1)
    if fortran or len(plane) != 2:
        stream.seek(begin)
        yield read_stream(stream, path, size)
        return
    yield from read_planes(stream, path, dtype, (shape[0], *plane))


def _check(stream: IO[bytes], path: Path, size: int, *, at_once: bool = True) -> Header:
    """The header, checked for plausibility; `stream` then stands at the first byte of the data."""
    shape, fortran, dtype = read_header(stream, path)
    if dtype.hasobject:
        raise DataError(f"{path}: holds pickled Python objects, which are never loaded; save plain numbers")
    check_size(path, math.prod(shape) * dtype.itemsize, size - stream.tell(), at_once=at_once)
    return shape, fortran, dtype
