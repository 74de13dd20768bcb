"""Strengths of the pattern are right under noise that is neither white nor fine."""

import numpy as np
import pytest
from pedestal import NOISE, OFFSET, PEDESTAL, SIZE, camera
from scipy import ndimage

import deepir


def white():
    return NOISE * np.random.default_rng(1).standard_normal((12, *SIZE))


def coloured():
    each = ndimage.gaussian_filter(white(), (0, 0.8, 0.8))[4:]
    return NOISE * each / each.std()


def filtered_in_time():
    """Of a camera that gives the mean of each three frames."""
    noise = white()
    return (noise[4:] + noise[3:-1] + noise[2:-2]) / 3**0.5


@pytest.mark.parametrize(
    ("noise", "step"),
    [(coloured, 1.0), pytest.param(coloured, 16.0, marks=pytest.mark.slow), (filtered_in_time, 1.0)],
)
def test_pixels_are_as_strong_as_they_are(noise, step):
    frames, _, _ = camera(PEDESTAL, noise())
    frames = (step * np.round(frames / step)).astype(np.float32)
    found = deepir.run("nuc", frames=frames).metrics["strengths"]
    assert found["offset.pixel.sigma"] == pytest.approx(OFFSET, rel=0.15)
