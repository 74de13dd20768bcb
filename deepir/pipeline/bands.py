"""Frames of several bands: each has a scene and a sensor of its own, and all share the motion of the clearest."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
import torch

from deepir.arrays.noise_level import sample_noise
from deepir.burst import Burst
from deepir.messages import Message
from deepir.operators.geometry import rescale_motion
from deepir.result import Result

#: Problems that take several bands.
PROBLEMS = ("nuc", "generic")
#: What each band has by itself; the motion and the frames that are used are those of all.
OWN = ("scene", "gain", "offset", "level", "bad_pixels")


def solve_bands(burst: Burst, solve: Callable[[Burst], Result]) -> Result:
    """The clearest band by itself, then the others with its motion.

    Args:
        burst: The first band, with the others in `bands`.
        solve: Of a burst of one band.

    Returns:
        A result whose arrays have the bands first, (C, H, W).
    """
    bands = [dataclasses.replace(burst, bands=()), *burst.bands]
    lead = int(np.argmax([contrast_to_noise(band) for band in bands]))
    first = solve(bands[lead])
    motion = None
    if first.frames_used.sum() > 1:  # else its motion is not trusted, and each band finds its own
        ratio = first.scene.shape[-1] / burst.size[1]
        motion = rescale_motion(torch.from_numpy(first.motion), 1 / ratio).numpy()
    results = [
        first if c == lead else solve(dataclasses.replace(band, motion=motion))
        for c, band in enumerate(bands)
    ]
    return _stacked(results, lead)


def contrast_to_noise(band: Burst) -> float:
    """How much the frames change as the camera moves, relative to their noise; a fixed pattern does not count."""
    if len(band.frames) < 2:
        return 0.0
    levels = [
        np.median(frame[ok]) if ok.any() else 0.0 for frame, ok in zip(band.frames, band.valid, strict=True)
    ]
    change = np.diff(np.where(band.valid, band.frames - np.reshape(levels, (-1, 1, 1)), 0.0), axis=0)
    noise = sample_noise(torch.from_numpy(band.frames), torch.from_numpy(band.valid & ~band.bad_pixels))
    return float(change.std()) / max(noise, 1e-30)


def _stacked(results: list[Result], lead: int) -> Result:
    """One result of those of the bands; `metrics` are those of the clearest, and of each under `bands`."""
    first = results[lead]
    shared = set.intersection(*(set(each.extra) for each in results))
    spread = set.intersection(*(set(each.uncertainty) for each in results))
    whole = dataclasses.replace(
        first,
        example=results[0].example,
        extra={name: np.stack([each.extra[name] for each in results]) for name in sorted(shared)},
        uncertainty={name: np.stack([each.uncertainty[name] for each in results]) for name in sorted(spread)},
        metrics=first.metrics | {"clearest_band": lead, "bands": [each.metrics for each in results]},
        messages=[
            text.within(f"band {c}") if isinstance(text, Message) else f"band {c}: {text}"
            for c, each in enumerate(results)
            for text in each.messages
        ],
    )
    for name in OWN:
        setattr(whole, name, np.stack([getattr(each, name) for each in results]))
    return whole
