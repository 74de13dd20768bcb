"""Recordings of cameras of 240 to 512 rows, drawn from scikit-image's pictures, with exact truth.

The level of the frames drifts as that of a camera without a shutter does, so that slopes of the pattern are known only
in part. Frames of so many rows are averaged before they are solved.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import skimage.data
from recordings_cases import Case
from recordings_methods import BURST, Correction
from recordings_scores import Figures, bad_pixels, covered, left_over, likeness
from scipy import ndimage
from skimage.color import rgb2gray

FAMILIES = ("large",)
CODE = ("recordings_large.py",)
SIZES = ((512, 640), (480, 640), (288, 384), (240, 320))
PICTURES = (
    *("coffee", "rocket", "astronaut", "chelsea", "brick", "gravel"),
    *("retina", "hubble_deep_field", "immunohistochemistry", "camera", "moon", "grass"),
)
STRENGTHS = (0.03, 0.1, 0.4)  # of the pattern, in the scene's contrast
LEVEL = 8000.0  # counts
LEVEL_STEP = 0.002  # standard deviation from frame to frame, in the scene's contrast
TURN = np.radians(4.5)  # deviation of a hand's turns
STRIDE = 4  # frames, of which one is judged

Array = np.ndarray[Any, Any]


def missing(family: str) -> str:
    return ""


def names(family: str, seed: int) -> list[str]:
    return [f"{height} x {width}" for height, width in SIZES]


def load(family: str, name: str, seed: int) -> Case:
    number = names(family, seed).index(name)
    frames, scenes, pattern = drawn(SIZES[number], np.random.default_rng([seed, number]))
    whole = np.ones(frames.shape[1:], bool)

    def judge(corrected: Array, correction: Correction) -> Figures:
        error = (corrected - scenes).mean(0)
        return {
            **left_over(error - error.mean(), pattern),
            "likeness": likeness(corrected, scenes, whole),
            "raw likeness": likeness(frames[::STRIDE], scenes, whole),
            **covered(correction.error(pattern, error), correction.deviation),
            **bad_pixels(correction.bad_pixels, ~whole),
        }

    return Case(frames, np.arange(0, len(frames), STRIDE), judge, max(1, (len(frames) - 1) // (BURST - 1)))


def drawn(size: tuple[int, int], rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Frames (N, h, w), uint16; every fourth scene; the pattern at its mean level, (h, w), mean zero."""
    kind, count = rng.choice(["pan", "scan", "hand", "turn"]), int(rng.integers(40, 140))
    reach = int(size[1] * (rng.uniform(0.02, 0.15) if kind == "hand" else rng.uniform(0.1, 0.6)))
    contrast = rng.uniform(100, 1500)
    picture = contrast * _picture(rng.choice(PICTURES), [side + 2 * reach + 40 for side in size])
    y, x, angles = _path(kind, count, reach, rng)
    strength, noise = contrast * rng.choice(STRENGTHS), contrast * rng.uniform(0.003, 0.01)
    low, fine, gain = _pattern(size, strength, rng)
    coefficients = ndimage.spline_filter(picture, 3).astype(np.float32)
    rows, columns = (each - (side - 1) / 2 for each, side in zip(np.indices(size), size, strict=True))
    levels = LEVEL + np.cumsum(rng.normal(0, LEVEL_STEP * contrast, count))
    frames, scenes = np.empty((count, *size), np.uint16), []
    for k, (angle, level) in enumerate(zip(angles, levels, strict=True)):
        at = (
            np.cos(angle) * rows + np.sin(angle) * columns + y[k] + (picture.shape[0] - 1) / 2,
            np.cos(angle) * columns - np.sin(angle) * rows + x[k] + (picture.shape[1] - 1) / 2,
        )
        scene = ndimage.map_coordinates(coefficients, at, order=3, prefilter=False, mode="mirror")
        frames[k] = (level + gain * scene + low + fine + rng.normal(0, noise, size)).round().clip(0, 65535)
        if k % STRIDE == 0:
            scenes.append(level + scene)
    shown = np.stack(scenes)
    pattern = (frames[::STRIDE] - shown).mean(0)
    return frames, shown, pattern - pattern.mean()


def _picture(name: str, needed: list[int]) -> Array:
    """A grey picture of this size, enlarged where it is smaller."""
    picture = getattr(skimage.data, name)()
    grey = (rgb2gray(picture) if picture.ndim == 3 else picture / 255.0).astype(np.float32)
    factor = max(1.0, *(need / side for need, side in zip(needed, grey.shape, strict=True)))
    grey = ndimage.zoom(grey, 1.01 * factor, order=3) if factor > 1 else grey
    return np.asarray(grey[: needed[0], : needed[1]])


def _path(kind: str, count: int, reach: int, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Rows, columns, px, and angles of each frame."""
    time = np.arange(count) / count

    def wander(smoothness: float) -> Array:
        return ndimage.gaussian_filter1d(rng.normal(0, 1, count + 200), smoothness)[100:-100]

    still = np.zeros(count)
    if kind == "pan":
        y, x = (reach * np.sin(rng.uniform(3, 14) * time + rng.uniform(0, 6)) for _ in range(2))
        return y, x, still
    if kind == "scan":
        return 0.3 * reach * np.sin(8 * np.pi * time), reach * (2 * time - 1), still
    y, x = wander(rng.uniform(2, 8)), wander(rng.uniform(2, 8))
    scale = reach / max(np.abs(y).max(), np.abs(x).max())
    return scale * y, scale * x, TURN * wander(5.0)


def _pattern(size: tuple[int, int], strength: float, rng: np.random.Generator) -> tuple[Array, Array, Array]:
    """Low-order part, fine part, and gain, (h, w) each."""
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in size), indexing="ij")
    a, b, c, d, e = rng.normal(0, [1, 1, 1, 0.5, 0.5])
    low = a * y + b * x + c * (x**2 + y**2) + d * x * y + e * np.cos(3 * x + rng.uniform(0, 6))
    low = (low - low.mean()) / low.std() * strength * rng.uniform(0.5, 2)
    fine = 0.5 * rng.normal(size=size) + 0.5 * rng.normal(size=size[1]) + 0.2 * rng.normal(size=(size[0], 1))
    return low, strength * fine, 1 + 0.01 * rng.normal(size=size)
