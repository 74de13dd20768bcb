"""The rival that takes shading for a low-rank part and the scenes for a sparse rest."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.baselines.temporal.basic import flat_and_dark_field

SHAPE, COUNT = (40, 48), 40


@pytest.fixture(scope="module")
def microscope():
    """Forty exposures of few bright cells under shading: frames and their flat field."""
    rng = np.random.default_rng(0)
    y, x = np.meshgrid(*(np.linspace(-1, 1, side) for side in SHAPE), indexing="ij")
    flat = 1 - 0.3 * (x**2 + y**2) + 0.1 * x
    cells = ndimage.gaussian_filter(rng.normal(size=(COUNT, *SHAPE)), (0, 3, 3)) > 0.1
    exposures = rng.uniform(0.6, 1.4, (COUNT, 1, 1))
    frames = 100 * (exposures + cells * rng.uniform(0.3, 1.0, (COUNT, 1, 1))) * flat
    return frames + rng.normal(size=frames.shape), flat / flat.mean()


def error(found, flat):
    return np.std(found / found.mean() - flat) / np.std(flat)


def test_sparse_scenes_stay_out_of_the_flat_field(microscope):
    frames, flat = microscope
    found, dark = flat_and_dark_field(frames)
    assert error(found, flat) < 0.8 * error(frames.mean(0), flat)
    assert error(found, flat) < 0.2
    assert found.mean() == pytest.approx(1)
    assert dark.mean() == pytest.approx(0, abs=1e-9)


def test_another_unit_scales_the_dark_field_alone(microscope):
    frames, _ = microscope
    found, again = flat_and_dark_field(frames), flat_and_dark_field(8 * frames)
    np.testing.assert_allclose(again[0], found[0], rtol=1e-6)
    np.testing.assert_allclose(again[1], 8 * found[1], atol=1e-6)
