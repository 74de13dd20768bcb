"""Planes of samples that lie one after the other in a file, read one at a time.

A memory map would count towards the process's memory, and end it by a signal if the file is cut meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import IO, Any

import numpy as np

from deepir.errors import DataError

Array = np.ndarray[Any, np.dtype[Any]]


def stream_planes(path: Path, dtype: np.dtype[Any], offset: int, shape: Sequence[int]) -> Iterator[Array]:
    """The arrays `shape[1:]` of an array in C order; `offset`: bytes before its first sample. Else as `read_planes`."""
    with path.open("rb") as file:
        file.seek(offset)
        yield from read_planes(file, path, dtype, shape)


def read_planes(stream: IO[bytes], path: Path, dtype: np.dtype[Any], shape: Sequence[int]) -> Iterator[Array]:
    """The arrays `shape[1:]` of an array in C order.

    Args:
        stream: At the first sample.
        path: The file, for messages.
        dtype: Of a sample, byte order included.
        shape: Of the whole array.

    Raises:
        DataError: The stream ends before the array does.
    """
    size = math.prod(shape[1:]) * dtype.itemsize
    for number in range(shape[0]):
        data = stream.read(size)
        if len(data) < size:
            raise DataError(f"{path}: truncated: it ends within frame {number} of {shape[0]}")
        yield np.frombuffer(data, dtype).reshape(shape[1:])
