"""Frames of different scenes: one sensor, no motion."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial

import numpy as np

from deepir.errors import DataError
from deepir.simulate.optics.blur import blur_picture
from deepir.simulate.optics.rendering import (
    draw_scene,
    picture_scale,
    render,
    render_reference,
    visible_reach,
)
from deepir.simulate.scenes.procedural import Scene, procedural
from deepir.simulate.settings import Settings


def render_own_scenes(
    scenes: Scene | Sequence[Scene] | None, settings: Settings, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray, float]:
    """Render one frame of each scene.

    Args:
        scenes: One for each frame; None: drawn with seeds of `rng`.
        settings: The camera.
        rng: Random stream of the scenes.

    Returns:
        Flux of each frame in ranges, (N, H, W); the same on the truth's grid; picture px per detector px of frame 0.

    Raises:
        DataError: There are fewer scenes than frames, or one is invalid or too small.
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
    reach = visible_reach(still, settings)
    frames, fine, scales = [], [], []
    for scene in scenes[: settings.n_frames]:
        picture = draw_scene(scene, reach, settings)
        scales.append(picture_scale(picture.shape, reach, settings))
        behind = blur_picture(picture, scales[-1], settings)
        frames.append(render(behind, still, settings.shape, scales[-1], settings.psf_sigma)[0])
        fine.append(render_reference(picture, scales[-1], settings) if settings.factor > 1 else frames[-1])
    return np.array(frames), np.array(fine), scales[0]
