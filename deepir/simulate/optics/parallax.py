"""Dense displacements of a simulated burst, and stray flux."""

from __future__ import annotations

import numpy as np
from scipy.special import ndtr

from deepir.errors import ConfigError
from deepir.simulate.settings import Settings

HILL_COUNT = 8  # hills of the relief
HILL_WIDTHS = (0.08, 0.2)  # least and largest sigma of a hill, in shorter sides of the frame
MAX_PARALLAX = 0.05  # in shorter sides of the frame; above, hills hide each other
MAX_FIXED_POINT_ITERATIONS = 60  # iterations of the nearness at a frame's pixels


def relief(settings: Settings, rng: np.random.Generator) -> np.ndarray:
    """Random hills, scaled so that nearness is within [0, 1].

    Returns:
        (K, 4): x and y in detector px from the centre, width (px), height.

    Raises:
        ConfigError: The hills would hide each other, or the camera does not shift.
    """
    height, width = settings.shape
    side = min(height, width)
    if settings.parallax > MAX_PARALLAX * side:
        raise ConfigError(
            f"simulate.parallax = {settings.parallax:g}: hills would hide each other; at most "
            f"{MAX_PARALLAX * side:g} px for frames of {height} x {width} px"
        )
    if not settings.max_shift:
        raise ConfigError(
            "simulate.parallax: a camera that does not shift sees none; raise simulate.max_shift, or take 0"
        )
    places = rng.uniform(-0.5, 0.5, (HILL_COUNT, 2)) * (width, height)
    hills = np.column_stack(
        (places, side * rng.uniform(*HILL_WIDTHS, HILL_COUNT), rng.uniform(0.5, 1, HILL_COUNT))
    )
    y, x = (np.arange(n) - (n - 1) / 2 for n in settings.shape)
    hills[:, 3] /= nearness(hills, x, y[:, None]).max()
    return hills


def nearness(hills: np.ndarray, x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Nearness of the scene at points of frame 0: 0 is the farthest, 1 the nearest."""
    return sum(
        tall * np.exp(((x - at_x) ** 2 + (y - at_y) ** 2) / (-2 * wide**2))
        for at_x, at_y, wide, tall in hills
    )


def parallax(motion: np.ndarray, hills: np.ndarray, settings: Settings) -> np.ndarray:
    """Displacement of the points where pixels look, added to the homography.

    A frame shifted by t sees a point of nearness d at `q = T p + parallax d(q) t / max_shift`. Points of the scene keep
    their nearness, so q is a fixed point, which exists as long as no hill hides another.

    Args:
        motion: (N, 3, 3), pull homographies, px.
        hills: (K, 4), see `relief`.
        settings: The camera.

    Returns:
        (N, 2, H, W), x and y, px.
    """
    found = np.zeros((len(motion), 2, *settings.shape))
    for k, T in enumerate(motion):
        at_x, at_y = sampling_points(T, settings.shape)
        toward = settings.parallax * T[:2, 2] / settings.max_shift
        near = np.zeros(settings.shape)
        for _ in range(MAX_FIXED_POINT_ITERATIONS):
            before, near = near, nearness(hills, at_x + toward[0] * near, at_y + toward[1] * near)
            if np.abs(near - before).max() < 1e-6:
                break
        found[k] = toward[:, None, None] * near
    return found


def sampling_points(T: np.ndarray, shape: tuple[int, int]) -> tuple[np.ndarray, np.ndarray]:
    """Points where the pixels of a frame look by the homography alone, x and y from its centre, px."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    at_x, at_y, w = (row[0] * x + row[1] * y[:, None] + row[2] for row in T)
    return at_x / w, at_y / w


def dense_flow(motion: np.ndarray, shape: tuple[int, int], beside: np.ndarray | None) -> np.ndarray:
    """Displacement from each pixel to the point where it looks, (N, 2, H, W), px."""
    y, x = (np.arange(n) - (n - 1) / 2 for n in shape)
    looks = np.array(
        [np.stack(sampling_points(T, shape)) - np.stack(np.broadcast_arrays(x, y[:, None])) for T in motion]
    )
    return looks if beside is None else looks + beside


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
