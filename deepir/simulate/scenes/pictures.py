"""Scenes of the simulated camera, by name."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from deepir.errors import DataError, nearest
from deepir.paths import expanded
from deepir.simulate.scenes.procedural import procedural, sky

#: Functions that draw a scene of a given seed and shape: `procedural:3`.
DRAWN_SCENES = {"procedural": procedural, "sky": sky}
#: Pictures that scikit-image ships.
SKIMAGE_PICTURES = ("astronaut", "brick", "camera", "cell", "chelsea", "clock", "coffee", "coins", "grass", "gravel",
    "hubble_deep_field", "immunohistochemistry", "moon", "page", "retina", "rocket", "stereo_motorcycle", "text",
)  # fmt: skip

Scene = np.ndarray[Any, Any] | Callable[[tuple[int, int]], np.ndarray[Any, Any]]


def load_picture(name: str) -> Scene | list[Scene]:
    """A scene by name.

    Args:
        name: A file, `procedural:SEED`, `sky:SEED`, or a picture of scikit-image: `camera`. Several, separated by
            commas, make a list.

    Returns:
        A grey picture (height, width), its range stretched to [0, 1], or a function that draws one of a given shape.

    Raises:
        DataError: There is none of that name, or it is not a picture.
    """
    if "," in name and not Path(name).exists():
        return [each for part in name.split(",") if not isinstance(each := load_picture(part.strip()), list)]
    kind, _, seed = name.partition(":")
    if kind in DRAWN_SCENES and seed.isdecimal():
        return partial(DRAWN_SCENES[kind], int(seed))
    if name in SKIMAGE_PICTURES and not Path(name).exists():
        return _stretched(_shipped(name), name)
    if not (Path(name).suffix or expanded(name).exists()):
        raise DataError(
            f"scene: no picture is called '{name}'; {nearest(name, SKIMAGE_PICTURES)}, "
            "procedural:SEED, sky:SEED or a file"
        )
    from deepir.io import read_frames

    frames = read_frames(name).frames
    if len(frames) != 1:
        raise DataError(f"{name}: a scene is one picture, this has {len(frames)}")
    return _stretched(frames[0].astype(np.float64), name)


def _shipped(name: str) -> np.ndarray[Any, Any]:
    import skimage.data
    from skimage.color import rgb2gray

    found = getattr(skimage.data, name)()
    whole = np.asarray(found[0] if isinstance(found, tuple) else found) / 255  # a stereo pair's left one
    return rgb2gray(whole) if whole.ndim == 3 else whole


def _stretched(whole: np.ndarray[Any, Any], name: str) -> np.ndarray[Any, Any]:
    low, high = whole.min(), whole.max()
    if not (np.isfinite(whole).all() and high > low):
        raise DataError(f"{name}: a scene is a picture that is finite and not constant")
    return (whole - low) / (high - low)
