"""Planes of samples that lie one after the other in a file, read one at a time.

A memory map would count towards the process's memory, and end it by a signal if the file is cut meanwhile.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError

Array = np.ndarray[Any, np.dtype[Any]]


def stream_planes(path: Path, dtype: np.dtype[Any], offset: int, shape: Sequence[int]) -> Iterator[Array]:
    """The arrays `shape[1:]` of an array in C order.

    Args:
        path: The file.
        dtype: Of a sample, byte order included.
        offset: Bytes before the first sample.
        shape: Of the whole array.

    Raises:
        DataError: The file ends before the array does.
    """
    size = math.prod(shape[1:]) * dtype.itemsize
    with path.open("rb") as file:
        file.seek(offset)
        for number in range(shape[0]):
            data = file.read(size)
            if len(data) < size:
                raise DataError(f"{path}: truncated: it ends within frame {number} of {shape[0]}")
            yield np.frombuffer(data, dtype).reshape(shape[1:])
