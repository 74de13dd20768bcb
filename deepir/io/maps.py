"""Files beside the frames: a mask of pixels to ignore, and a known truth."""

from __future__ import annotations

import os
from typing import Any

import numpy as np

from deepir.arrays.samples import as_float32
from deepir.errors import DataError
from deepir.io import readers
from deepir.io.frames import to_stack
from deepir.io.inspection.checks import Mask
from deepir.io.readers.numpy_arrays import read_npz
from deepir.paths import expanded

Shape = tuple[int, int]


def read_mask(path: str | os.PathLike[str], shape: Shape) -> Mask:
    """Mask (h, w) of pixels to ignore: True where an array or a picture is nonzero.

    Args:
        path: The file.
        shape: Height and width of a frame.

    Raises:
        DataError: It has another shape, or ignores every pixel.
    """
    file = expanded(path)
    array = readers.opened(file).read()
    if array.dtype.kind == "b":
        array = array.astype(np.uint8)
    mask = np.ma.getdata(to_stack(array, str(file))) != 0
    if mask.shape != (1, *shape):
        raise DataError(f"{file}: the mask is {_size(mask.shape)}, the frames are {_size(shape)}")
    if mask.all():
        raise DataError(f"{file}: the mask ignores every pixel; anything but zero means `ignore`")
    return mask[0]


def read_truth(path: str | os.PathLike[str], shape: Shape) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """Known arrays of simulated or calibrated data by name, float32.

    An `.npz` has `scene`, and may have gain, offset, motion ...; any other file is a picture of the scene.

    Args:
        path: The file.
        shape: Height and width of a frame.

    Returns:
        Arrays by name; the scene is (Q h, Q w) with an integer Q, or (N, Q h, Q w) with a scene for each frame.

    Raises:
        DataError: There is no scene, or it does not fit `shape`.
    """
    file = expanded(path)
    named = read_npz(file)
    return fit_truth({"scene": readers.opened(file).read()} if named is None else named, shape, str(file))


def fit_truth(
    arrays: dict[str, readers.Array], shape: Shape, source: str
) -> dict[str, np.ndarray[Any, np.dtype[np.float32]]]:
    """Check that a known scene fits frames of a `shape`, and give all known arrays by name, float32.

    Raises:
        DataError: There is no scene, or it does not fit; the message names the `source`.
    """
    if "scene" not in arrays:
        raise DataError(f"{source}: a truth needs an array `scene`; this has {', '.join(sorted(arrays))}")
    scene = to_stack(arrays["scene"], f"{source}[scene]")
    factor = max(1, scene.shape[1] // shape[0])
    if scene.shape[1:] != (factor * shape[0], factor * shape[1]):
        raise DataError(
            f"{source}: the scene is {_size(scene.shape)}, expected {_size(shape)}, or both sides a multiple of it"
        )
    arrays = arrays | {"scene": scene[0] if len(scene) == 1 else scene}
    return {name: as_float32(array) for name, array in arrays.items() if array.dtype.kind in "uif"}


def _size(shape: tuple[int, ...]) -> str:
    return " x ".join(str(n) for n in (shape[1:] if shape[0] == 1 else shape)) + " px"
