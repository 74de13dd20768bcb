"""Samples of frames as float32."""

import numpy as np

from deepir.arrays.samples import as_float32


def test_masked_samples_are_nan_and_the_frame_is_copied():
    frame = np.ma.masked_equal(np.array([[7, 0], [65535, 9]], np.uint16), 0)
    assert np.array_equal(as_float32(frame), np.array([[7, np.nan], [65535, 9]], np.float32), equal_nan=True)
    plain = np.ones((2, 2), np.float32)
    assert not np.shares_memory(as_float32(plain), plain)
