"""Windows and blocks of pixels agree with SciPy's and numpy's."""

import numpy as np
import pytest
from scipy import ndimage

from deepir.kernels.block_means import block_means
from deepir.kernels.median_filter import median_filter


@pytest.mark.parametrize("side", [3, 5, 7])
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(5, 9), (61, 83), (400, 301)])
def test_a_median_filter_is_that_of_scipy(shape, dtype, side):
    picture = np.random.default_rng(1).standard_normal(shape).astype(dtype)
    picture.ravel()[::3] = 0  # ties

    np.testing.assert_array_equal(median_filter(picture, side), ndimage.median_filter(picture, side))


def test_means_of_blocks_are_those_of_their_usable_samples():
    rng = np.random.default_rng(2)
    frames, usable = rng.standard_normal((3, 13, 18)).astype(np.float32), rng.random((3, 13, 18)) > 0.4
    usable[1, :4, :4] = False

    means = block_means(frames, usable, 4)

    blocks = np.where(usable, frames, np.nan)[:, :12, :16].reshape(3, 3, 4, 4, 4)
    expected = np.nanmean(
        np.where(usable[:, :12, :16].reshape(blocks.shape).any((2, 4), keepdims=True), blocks, 0), (2, 4)
    )
    expected[1, 0, 0] = np.median(frames[1][usable[1]])
    np.testing.assert_allclose(means, expected, rtol=1e-5, atol=1e-6)
