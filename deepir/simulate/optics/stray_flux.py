"""Stray flux from lenses and housing (narcissus)."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from deepir.simulate.settings import Settings


def stray_flux(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Stray flux of each pixel, (H, W), in ranges: from zero to `settings.stray`."""
    height, width = settings.shape
    y, x = (np.arange(side) - (side - 1) / 2 for side in settings.shape)
    shape = STRAY_SHAPES[settings.stray_shape](y[:, None] / height, x / height, width / height, rng)
    shape = shape - shape.min()
    return settings.stray * shape / shape.max()


# Below, y and x are distances from the frame's centre and `wide` is the frame's width, in heights of the frame.


def smooth(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """Glow of the housing: four warm or cold spots."""
    found = np.zeros(np.broadcast_shapes(y.shape, x.shape))
    for at_y, at_x, size, warmth in zip(
        rng.uniform(-0.5, 0.5, 4),
        wide * rng.uniform(-0.5, 0.5, 4),
        rng.uniform(0.3, 0.6, 4),
        rng.choice([-1, 1], 4),
        strict=True,
    ):
        found += warmth * np.exp(-((y - at_y) ** 2 + (x - at_x) ** 2) / (2 * size**2))
    return found


def radial(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """About the optical axis: reflection of the detector in a lens (a spot), and the barrel around."""
    at_y, at_x, spot, focus = rng.uniform((-0.05, -0.05, 0.15, 0.8), (0.05, 0.05, 0.3, 1.2))
    r2 = (y - at_y) ** 2 + (x - at_x) ** 2
    barrel = 1 - (1 + r2 / focus**2) ** -2  # complement of the cos^4 falloff
    return barrel + rng.choice([-0.5, 0.5]) * np.exp(-r2 / (2 * spot**2))


def ring(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """The defocused ghost of a stop."""
    at_y, at_x, radius, blur = rng.uniform((-0.1, -0.1, 0.2, 0.04), (0.1, 0.1, 0.4, 0.08))
    return np.exp(-((np.hypot(y - at_y, x - at_x) - radius) ** 2) / (2 * blur**2))


def edge(y: np.ndarray, x: np.ndarray, wide: float, rng: np.random.Generator) -> np.ndarray:
    """The defocused reflection of the camera's body in a polariser."""
    angle, place, blur = rng.uniform((0, -0.3, 0.04), (2 * np.pi, 0.3, 0.1))
    return ndtr((x * np.cos(angle) + y * np.sin(angle) - place) / blur)


#: Shapes by their name in the settings.
STRAY_SHAPES = {"smooth": smooth, "radial": radial, "ring": ring, "edge": edge}
