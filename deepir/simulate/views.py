"""Frames of different scenes: one sensor, no motion."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from deepir.errors import DataError
from deepir.simulate.optics.blur import blurred
from deepir.simulate.optics.rendering import at_rest, drawn, reach_of, render, scale_of
from deepir.simulate.scenes.pictures import Scene
from deepir.simulate.scenes.procedural import procedural
from deepir.simulate.settings import Settings


def look(
    scenes: Scene | Sequence[Scene] | None, settings: Settings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Flux of each frame in units of the range, (N, H, W); the same `factor` times as fine; scale of frame 0.

    Args:
        scenes: One for each frame; None: drawn with seeds of `rng`.
        settings: The camera.
        rng: The scenes' own random stream.

    Raises:
        ConfigError: Something is asked for that a scene has for several frames.
        DataError: There are fewer scenes than frames, or one is no picture, or too small.
    """
    if scenes is None:
        seeds = rng.integers(2**31, size=settings.n_frames)
        scenes = [partial(procedural, int(seed)) for seed in seeds]
    scenes = list(scenes) if isinstance(scenes, Sequence) else [scenes]
    if len(scenes) < settings.n_frames:
        raise DataError(
            f"scene: {len(scenes)} picture(s) for {settings.n_frames} frames, each of a scene of its own"
        )
    still = np.eye(3)[None]
    reach = reach_of(still, settings)
    frames, fine, scales = [], [], []
    for scene in scenes[: settings.n_frames]:
        picture = drawn(scene, reach, settings)
        scales.append(scale_of(picture.shape, reach, settings))
        behind = blurred(picture, scales[-1], settings)
        frames.append(render(behind, still, settings.shape, scales[-1], settings.psf_sigma)[0])
        fine.append(at_rest(picture, scales[-1], settings) if settings.factor > 1 else frames[-1])
    return np.array(frames), np.array(fine), scales[0]
