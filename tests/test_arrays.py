"""A few samples stand for all; samples as float32."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir.arrays.samples import as_float32
from deepir.arrays.statistics import MAX_SAMPLES_PER_FRAME, masked_values, median, median_sigma, subsample


@given(height=st.integers(200, 600), width=st.integers(200, 800))
def test_they_are_enough_and_from_all_columns(height, width):
    column = torch.arange(width).expand(1, 1, height, width)
    (some,) = subsample(column)
    assert (
        some.shape[1] >= min(MAX_SAMPLES_PER_FRAME, height * width) / 6
    )  # a step that shares no factor with the width
    assert len(some.unique()) == width


def test_they_are_the_same_of_each():
    frames = torch.rand(2, 1, 300, 400)
    one, other = subsample(frames, 2 * frames)
    assert torch.equal(2 * one, other)


def test_a_small_burst_is_taken_whole():
    frames = torch.rand(3, 1, 160, 192)
    assert torch.equal(subsample(frames)[0], frames.flatten(1))


def test_samples_that_do_not_count_are_no_noise():
    precision = torch.full((2, 1, 30, 40), 0.25)
    precision[:, :, ::2] = 0
    assert median_sigma(precision) == 2


@settings(max_examples=30, deadline=None)
@given(st.lists(st.floats(width=32, allow_nan=False), min_size=1, max_size=40), st.sampled_from([1, 2, 5000]))
def test_the_median_of_many_is_torch_s(values, times):
    many = torch.tensor(values, dtype=torch.float32).repeat(times)
    assert median(many) == float(many.median())


def test_those_that_count_are_in_order():
    values, counts = torch.rand(3, 4, 5), torch.rand(3, 4, 5) > 0.5
    assert torch.equal(masked_values(values, counts), values[counts])


def test_masked_samples_are_nan_and_the_frame_is_copied():
    frame = np.ma.masked_equal(np.array([[7, 0], [65535, 9]], np.uint16), 0)
    assert np.array_equal(as_float32(frame), np.array([[7, np.nan], [65535, 9]], np.float32), equal_nan=True)
    plain = np.ones((2, 2), np.float32)
    assert not np.shares_memory(as_float32(plain), plain)
