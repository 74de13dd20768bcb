"""Bursts in counts of cameras whose pattern is small at a level: raw ones, and those behind a shutter."""

import numpy as np
from scipy import ndimage
from skimage import data

SIZE = (96, 128)
PEDESTAL = 7500.0
GAIN, OFFSET, NOISE = 0.02, 25.0, 4.0


def camera(level, noise=None):
    """Eight frames, float, their gain, and their offset at zero signal; `noise` (8, h, w), white unless given."""
    rng = np.random.default_rng(0)
    picture = ndimage.zoom(data.brick().astype(float), 0.6, order=1)
    scene = PEDESTAL + 150 * (picture - picture.mean()) / picture.std()
    shifts = rng.uniform(0, 14, (8, 2))
    y, x = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    flux = np.stack([ndimage.map_coordinates(scene, [y + 30 + dy, x + 30 + dx], order=3) for dy, dx in shifts])
    gain = 1 + GAIN * rng.standard_normal(SIZE)
    rest = OFFSET * rng.standard_normal(SIZE)
    white = NOISE * rng.standard_normal(flux.shape)
    frames = level + gain * (flux - level) + rest + (white if noise is None else noise)
    return frames, gain, rest + (1 - gain) * level
