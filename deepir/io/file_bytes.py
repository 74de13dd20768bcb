"""Bytes of a file, read where they are needed, and planes of samples in them."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import IO, Any, Self

import numpy as np

from deepir.errors import DataError
from deepir.io.guards import check_size

SEARCH_BYTES = 2**20  # read at once while bytes are sought
Array = np.ndarray[Any, np.dtype[Any]]


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

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
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


def read_samples(path: Path, dtype: np.dtype[Any], offset: int, shape: Sequence[int]) -> Array:
    """An array in C order; arguments as those of `stream_planes`. The file holds them, as its caller has checked."""
    size = math.prod(shape) * dtype.itemsize
    check_size(path, size, size)
    return np.fromfile(path, dtype, math.prod(shape), offset=offset).reshape(shape)


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
