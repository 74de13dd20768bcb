"""NumPy's `.npy`: one array. Nothing is ever unpickled."""

from __future__ import annotations

import math
from pathlib import Path
from typing import IO, Any

import numpy as np
from numpy.lib import format as npy_format

from deepir.errors import DataError
from deepir.io.guards import check_size
from deepir.io.readers import Array

SUFFIXES = (".npy",)


def sniff(head: bytes, path: Path) -> bool:
    """NumPy's magic string."""
    return head.startswith(npy_format.MAGIC_PREFIX)


def read(path: Path, key: str | None) -> Array:
    """The array as it is stored. Raises `DataError` for pickled objects and for a wrong length."""
    with path.open("rb") as file:
        return read_stream(file, path, path.stat().st_size)


def read_header(stream: IO[bytes], path: Path) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    """Shape, whether the order is Fortran's, and type; `stream` is left at the first byte of the data."""
    version = npy_format.read_magic(stream)
    # Version 3 only adds the names of record fields outside Latin-1, and records are no frames.
    readers = {(1, 0): npy_format.read_array_header_1_0, (2, 0): npy_format.read_array_header_2_0}
    if version not in readers:
        raise DataError(f"{path}: an array of format {version}; only plain arrays of numbers can be read")
    return readers[version](stream)


def read_stream(stream: IO[bytes], path: Path, size: int) -> Array:
    """One array from `stream`, which is `size` bytes long and at its beginning; `path` is for messages."""
    shape, fortran, dtype = read_header(stream, path)
    if dtype.hasobject:
        raise DataError(f"{path}: holds pickled Python objects, which are never loaded; save plain numbers")
    stored = size - stream.tell()
    declared = math.prod(shape) * dtype.itemsize
    check_size(path, declared, stored)
    # To the end, not only `declared` bytes: a zip checks its checksum there.
    data = stream.read()
    if len(data) != declared:
        raise DataError(f"{path}: damaged: {len(data):,} bytes where the header says {declared:,}")
    return np.frombuffer(data, dtype).reshape(shape, order="F" if fortran else "C")
