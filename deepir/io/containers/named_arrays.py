"""Which of the named arrays of a file is that of the frames."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from deepir.errors import DataError, nearest

PREFERRED_NAMES = ("frames", "raw")  # names of the array that holds the frames, in order of preference
MAX_LISTED = 20  # arrays that a message lists


def can_be_frames(shape: tuple[int, ...]) -> bool:
    """Whether an array may be a frame or a stack; MATLAB's numbers and vectors are matrices too, of one row."""
    return 2 <= len(shape) <= 4 and 2 <= sum(side > 1 for side in shape) <= 3


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
    pictures = [name for name, shape in shapes.items() if can_be_frames(shape)]
    if len(pictures) != 1:
        listing = ", ".join(f"{name} {shape}" for name, shape in sorted(shapes.items())[:MAX_LISTED])
        if len(shapes) > MAX_LISTED:
            listing += f" and {len(shapes) - MAX_LISTED} more"
        single = [shapes[name] for name in pictures if len(shapes[name]) == 2]
        each = len(single) > 2 and len(single) == len(pictures) and len(set(single)) == 1
        advice = "They look like a frame each: join them, as numpy.stack does, and save one. " if each else ""
        raise DataError(
            f"{path}: which array is meant? Give its key (data.key). {advice}Arrays: {listing or 'none'}"
        )
    return pictures[0]
