"""Small bright things in a plain scene are neither outliers nor defects: the first estimates of them are too low."""

import numpy as np
import pytest

import deepir
from deepir.metrics import scores
from deepir.simulate import Settings, simulate

CAMERA = {"shape": (96, 128), "n_frames": 5, "shading": 0.0, "dead_pixels": 0.0, "photons": 1000.0}
LINES = {"gain_column": 0.1, "gain_pixel": 0.02, "offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0}


def spots(seed, shape=(300, 380)):
    """A dark scene with lamps of a pixel and more, one as bright as all the range."""
    rng = np.random.default_rng(seed)
    y, x = np.ogrid[: shape[0], : shape[1]]
    scene = np.full(shape, 0.05)
    for brightness in rng.pareto(1.2, 120) * 0.05:
        at, width = rng.uniform(0, shape), rng.choice([1.2, 1.5, 2.0, 3.0])
        scene += brightness * np.exp(-((y - at[0]) ** 2 + (x - at[1]) ** 2) / (2 * width**2))
    return scene.clip(0, 1)


@pytest.mark.parametrize("seed", [5, pytest.param(7, marks=pytest.mark.slow)])
def test_lamps_in_the_dark_are_seen_as_they_are(seed):
    """Taken for what moves, they cost these bursts 5 and 10 dB, and good pixels before them were given up."""
    sim = simulate(spots(seed), Settings(**CAMERA, **LINES, read_noise=0.002), seed=seed)
    result = deepir.run("nuc", frames=sim.frames, threads=1)
    assert scores(result.scene, sim.truth.scene)["psnr_aligned"] > 53
    assert result.bad_pixels.sum() <= 3
