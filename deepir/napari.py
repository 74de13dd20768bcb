"""The reader that napari finds by `napari.yaml`: recordings, and the folders of runs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np

#: An array, its name and other options, and the kind of the layer.
Layer = tuple[np.ndarray[Any, Any], dict[str, Any], str]


def reader(path: str | Sequence[str]) -> Callable[[Any], list[Layer]] | None:
    """A function that reads a path, or None if it is no recording and no run."""
    from deepir.io import readers

    if not isinstance(path, str):
        return None
    known = (Path(path) / "result.npz").is_file() or Path(path).suffix.lower() in readers.suffixes()
    return read if known else None


def read(path: str) -> list[Layer]:
    """The frames of a recording; of a run's folder scene, gain, offset and bad pixels, all but the scene hidden."""
    from deepir.io import read_frames

    file = Path(path) / "result.npz"
    if not file.is_file():
        return [(read_frames(path).frames, {"name": Path(path).stem}, "image")]
    with np.load(file) as found:
        hidden = {"visible": False}
        bad = found["bad_pixels"].astype(np.uint8)
        return [
            (found["scene"], {"name": "scene"}, "image"),
            (found["gain"], {"name": "gain", "colormap": "turbo"} | hidden, "image"),
            (found["offset"], {"name": "offset", "colormap": "turbo"} | hidden, "image"),
            (bad, {"name": "bad pixels"} | hidden, "labels"),
        ]
