"""Values that stand for lost samples are no temperatures."""

import numpy as np
import pytest

from deepir.io import read_frames, stream_frames
from deepir.io.inspection.samples import FILL_VALUES, lost_samples


@pytest.fixture
def celsius():
    return np.random.default_rng(0).uniform(-20, 40, (3, 24, 32)).astype(np.float32)


@pytest.mark.parametrize("value", FILL_VALUES)
def test_a_fill_value_far_from_all_else_is_lost(tmp_path, celsius, value):
    celsius[:, :4] = value
    np.savez(tmp_path / "a.npz", frames=celsius)
    found = read_frames(tmp_path / "a.npz").frames
    assert np.isnan(found[:, :4]).all()
    assert np.isfinite(found[:, 4:]).all()


def test_a_value_within_the_range_of_the_others_is_a_value():
    frames = np.random.default_rng(0).integers(-12000, 12000, (3, 24, 32)).astype(np.float32)
    frames[0, :2] = -9999
    assert lost_samples(frames, np.dtype(np.int16)) is None


def test_unsigned_counts_have_no_fill_value(celsius):
    assert lost_samples(np.where(celsius < 0, np.float32(1e20), celsius), np.dtype(np.uint16)) is None


def test_zeros_below_all_other_floats_are_lost_and_others_are_not(celsius):
    celsius[0, :4] = 0
    assert lost_samples(celsius, celsius.dtype) is None
    warm = np.where(celsius == 0, 0, celsius + 40)
    np.testing.assert_array_equal(lost_samples(warm, warm.dtype), warm == 0)


def test_two_fill_values_are_both_lost(celsius):
    celsius[0, 0], celsius[1, 1] = -9999, -32768
    lost = lost_samples(celsius, celsius.dtype)
    assert lost is not None
    assert lost.sum() == 64


def test_the_largest_count_far_from_all_others_is_lost_in_whichever_frame(tmp_path):
    counts = np.random.default_rng(0).integers(7000, 9000, (3, 24, 32)).astype(np.uint16)
    counts[1, 5:9] = 65535
    np.savez(tmp_path / "a.npz", frames=counts)
    np.testing.assert_array_equal(np.isnan(read_frames(tmp_path / "a.npz").frames), counts == 65535)
    streamed = [np.ma.getmaskarray(frame) for frame in stream_frames(tmp_path / "a.npz")]
    np.testing.assert_array_equal(streamed, counts == 65535)


def test_counts_that_reach_up_to_the_largest_are_saturated_and_not_lost():
    counts = np.random.default_rng(0).integers(7000, 70000, (3, 24, 32)).clip(0, 65535).astype(np.uint16)
    assert lost_samples(counts, counts.dtype) is None


def test_a_recording_that_is_streamed_has_lost_samples_too(tmp_path, celsius):
    celsius[1, :4] = -9999
    np.save(tmp_path / "a.npy", celsius)
    streamed = [np.ma.getmaskarray(frame) for frame in stream_frames(tmp_path / "a.npy")]
    np.testing.assert_array_equal(streamed, celsius == -9999)
