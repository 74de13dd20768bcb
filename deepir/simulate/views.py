"""Frames of a simulated camera: its views, and what happens to them."""

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

MIN_FLUX_CHANGE = 1e-4  # change of flux, in ranges, from which a sample counts as moving


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


def observe(
    picture: np.ndarray,
    motion: np.ndarray,
    scale: float,
    settings: Settings,
    beside: np.ndarray | None,
    walk_rng: np.random.Generator,
    place_rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Render all frames with their events.

    Args:
        picture: (height, width), the scene.
        motion: (N, 3, 3), pull homographies, px.
        scale: Picture px per detector px.
        settings: The camera.
        beside: (N, 2, H, W), parallax, px; None: none.
        walk_rng: Random stream of the walker.
        place_rng: Random stream of the other place.

    Returns:
        Flux (N, H, W) in ranges; samples that the walker changes, (N, H, W) bool; flux of frame 0 without the walker.
    """

    def seen(scene: np.ndarray, frames: slice) -> np.ndarray:
        more = None if beside is None else beside[frames]
        behind = blur_picture(scene, scale, settings)
        return render(behind, motion[frames], settings.shape, scale, settings.psf_sigma, more)

    static = seen(picture, np.s_[:])
    flux, failed = static.copy(), settings.failed_frame
    if settings.walker:
        flux_of_walker = static[0].mean() + settings.walker_contrast
        for k, cover in enumerate(walker_cover(picture.shape, scale, settings, walk_rng)):
            flux[k] = seen(picture + cover * (flux_of_walker - picture), np.s_[k : k + 1])[0]
    if failed:
        another = procedural(int(place_rng.integers(2**31)), (picture.shape[0], picture.shape[1]))
        static[failed] = flux[failed] = seen(another, np.s_[failed : failed + 1])[0]
    return flux, np.abs(flux - static) > MIN_FLUX_CHANGE, static[0]


def walker_cover(
    shape: tuple[int, ...], scale: float, settings: Settings, rng: np.random.Generator
) -> list[np.ndarray]:
    """Cover of each picture px by the walker, in [0, 1], for each frame; the path is central at half time."""
    height, width = settings.shape
    tall, way = settings.walker * height, rng.choice([-1, 1])
    middle, feet = width * rng.uniform(-0.25, 0.25), height * rng.uniform(0.2, 0.45)
    y, x = ((np.arange(n) - (n - 1) / 2) / scale for n in shape)  # px of frame 0 from its centre
    covers = []
    for k in range(settings.n_frames):
        along = middle + way * settings.walker_speed * (k - (settings.n_frames - 1) / 2)
        gait = np.cos(np.pi * settings.walker_speed * k / (0.4 * tall))  # two steps are 0.8 of one's height
        distance = person_distance((x[None, :] - along) / tall, (feet - y[:, None]) / tall, 0.18 * gait)
        covers.append(np.clip(0.5 - distance * tall * scale, 0, 1))
    return covers


def person_distance(x: np.ndarray, y: np.ndarray, stride: float) -> np.ndarray:
    """Signed distance from a person of height one who stands at (0, 0); x to the right, y up."""
    parts = (
        ((0.0, 0.93), (0.0, 0.91), 0.07),  # head
        ((0.0, 0.75), (0.0, 0.52), 0.1),
        ((0.0, 0.48), (stride, 0.05), 0.05),
        ((0.0, 0.48), (-stride, 0.05), 0.05),
    )
    found = np.full(np.broadcast_shapes(x.shape, y.shape), np.inf)
    for (px, py), (qx, qy), radius in parts:
        dx, dy = qx - px, qy - py
        along = np.clip(((x - px) * dx + (y - py) * dy) / (dx * dx + dy * dy), 0, 1)
        np.minimum(found, np.hypot(x - px - along * dx, y - py - along * dy) - radius, out=found)
    return found
