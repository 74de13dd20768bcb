"""Which of a file's named arrays is meant."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from deepir.errors import DataError, nearest

PREFERRED_NAMES = ("frames", "raw")  # names of the array that holds the frames, in order of preference


def choose_array(shapes: Mapping[str, tuple[int, ...]], path: Path, key: str | None) -> str:
    """`key`, else `frames`, else `raw`, else the only array with two or three dimensions.

    Raises `DataError`, with the arrays there are, where that is none or several.
    """
    if key is not None and key not in shapes:
        raise DataError(f"{path}: no array '{key}'; {nearest(key, shapes)}")
    for name in (key, *PREFERRED_NAMES):
        if name in shapes:
            return str(name)
    # MATLAB's numbers and vectors are matrices too, of one row or one column.
    pictures = [name for name, shape in shapes.items() if len(shape) in (2, 3) and sorted(shape)[-2] > 1]
    if len(pictures) != 1:
        listing = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items()))
        raise DataError(f"{path}: which array is meant? Give its key (data.key). Arrays: {listing or 'none'}")
    return pictures[0]
