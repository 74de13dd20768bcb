"""MATLAB's `.mat`, versions 5 to 7: named arrays whose last axis is that of the frames. Version 7.3 is HDF5."""

from __future__ import annotations

import math
import struct
from pathlib import Path

import numpy as np
import scipy.io

from deepir.errors import DataError
from deepir.io.containers.named_arrays import can_be_frames, check_elements, choose_array
from deepir.io.guards import check_size
from deepir.io.readers import Array

ANY_AXES = True
SUFFIXES = (".mat",)
MATLAB_5 = b"MATLAB 5.0 MAT-file"
#: First number of a matrix in version 4, little- or big-endian: 1000 M + 10 P + T, P the type of values, T zero.
MATLAB_4 = tuple(
    struct.pack(f"{order}I", machine + 10 * kind)
    for order, machine in (("<", 0), (">", 1000))
    for kind in range(6)
)
#: Bytes per value of MATLAB's numeric classes; cells, structures and function handles are not frames.
BYTES_PER_VALUE = {"single": 4, "double": 8} | {
    f"{sign}int{n}": n // 8 for sign in ("", "u") for n in (8, 16, 32, 64)
}


def sniff(head: bytes, path: Path) -> bool:
    """The text at the head of files of MATLAB, Octave and SciPy; of version 4 the suffix and the head of a matrix."""
    return head.startswith(MATLAB_5) or (path.suffix.lower() == ".mat" and head[:4] in MATLAB_4)


def read(path: Path, key: str | None) -> Array:
    """The array, (h, w) or (N, h, w); MATLAB stores (h, w, N).

    Raises:
        DataError: It is not an array of numbers, or several are possible, or the file is of version 4.
    """
    with path.open("rb") as file:
        if not file.read(len(MATLAB_5)).startswith(MATLAB_5):
            raise DataError(
                f"{path}: a file of MATLAB 4, which is not read; load it in MATLAB and save it with '-v7'"
            )
    check_elements(path)
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
