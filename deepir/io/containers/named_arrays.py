"""Choice among the named arrays of a file."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from deepir.errors import DataError, nearest

PREFERRED_NAMES = ("frames", "raw")  # names of the array that holds the frames, in order of preference


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
    # MATLAB's numbers and vectors are matrices too, of one row or one column.
    pictures = [name for name, shape in shapes.items() if len(shape) in (2, 3) and sorted(shape)[-2] > 1]
    if len(pictures) != 1:
        listing = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items()))
        single = [shapes[name] for name in pictures if len(shapes[name]) == 2]
        each = len(single) > 2 and len(single) == len(pictures) and len(set(single)) == 1
        advice = "They look like a frame each: join them, as numpy.stack does, and save one. " if each else ""
        raise DataError(
            f"{path}: which array is meant? Give its key (data.key). {advice}Arrays: {listing or 'none'}"
        )
    return pictures[0]
