"""Thermal lag: pixels respond slowly while the camera moves between the frames."""

from __future__ import annotations

import itertools
from typing import TypeVar

import numpy as np

from deepir.simulate.settings import Settings

Values = TypeVar("Values", float, np.ndarray)

TREMOR_WAVES = 4  # sinusoids in the path of each motion parameter


def smooth_path(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """A smooth random path of the nine motion parameters, at `substeps` instants for each frame after the first.

    Returns:
        (I, 9), in [-1, 1]; zero at the first instant.
    """
    time = np.arange((settings.n_frames - 1) * settings.substeps + 1) / (settings.substeps * settings.fps)
    rate = 2 * np.pi * settings.tremor * rng.uniform(0.1, 1, (TREMOR_WAVES, 9))
    phase, size = rng.uniform(0, 2 * np.pi, (TREMOR_WAVES, 9)), rng.uniform(0.2, 1, (TREMOR_WAVES, 9))
    found = (size * np.sin(rate * time[:, None, None] + phase)).sum(1)
    found -= found[0]
    return found / np.abs(found).max(0).clip(min=1e-12)


def time_constants(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Time constant of each pixel (H, W), ms."""
    factors = 1 + settings.tau_pixel * rng.standard_normal(settings.shape)
    return settings.tau * factors.clip(min=0.2)


def apply_lag(flux: np.ndarray, tau: np.ndarray, settings: Settings) -> np.ndarray:
    """Frames of lagging pixels: `tau dy/dt = x - y`, exact for a flux that is linear between two instants.

    Before the first instant the pixels have settled.

    Args:
        flux: (I, H, W), at successive instants.
        tau: (H, W), time constants, ms.
        settings: The camera.

    Returns:
        (N, H, W), as read out.
    """
    kept, old, new = lag_coefficients(1000 / (settings.fps * settings.substeps) / tau)
    shown = [flux[0]]
    for before, now in itertools.pairwise(flux):
        shown.append(kept * shown[-1] + old * before + new * now)
    return rolling_readout(np.stack(shown), settings)


def lag_coefficients(step: Values) -> tuple[Values, Values, Values]:
    """Weights of the previous output, the previous flux and the current flux after a `step` in time constants."""
    kept = np.exp(-step)
    new = 1 - (1 - kept) / step
    return kept, 1 - kept - new, new


def rolling_readout(shown: np.ndarray, settings: Settings) -> np.ndarray:
    """Frames whose rows are read one after the other, the last one at the end of its frame."""
    height = settings.shape[0]
    early = settings.substeps * settings.readout * (1 - np.arange(1, height + 1) / height)
    at = np.arange(settings.n_frames)[:, None] * settings.substeps - early
    at = at.clip(min=0)  # (N, H)
    first = np.minimum(at.astype(int), len(shown) - 2 if len(shown) > 1 else 0)
    part = (at - first)[..., None]
    rows = np.arange(height)
    return (1 - part) * shown[first, rows] + part * shown[np.minimum(first + 1, len(shown) - 1), rows]
