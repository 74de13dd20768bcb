import numpy as np
import pytest

from deepir.errors import DataError
from deepir.io import crop, validate
from deepir.io.frames import selected_in_float32
from deepir.io.inspection.checks import unrecorded_samples


@pytest.fixture
def frames(burst):
    return burst.astype(np.float32)


def test_samples_that_are_not_finite_are_not_valid(frames):
    assert validate(frames, "a").all()
    frames[:2, 4, 5] = np.nan
    frames[0, 6, 7] = np.inf
    assert np.argwhere(~validate(frames, "a")).tolist() == [[0, 4, 5], [0, 6, 7], [1, 4, 5]]


@pytest.mark.parametrize(
    ("where", "value", "message"),
    [
        (np.s_[1, :11], np.nan, "frame 1 is 55% NaN or infinite"),
        (np.s_[2], 7, r"frame 2 is 7 everywhere \(a shutter, or lost\)"),
        (np.s_[:, :, 1::2], np.nan, "no sample has finite neighbours"),
        (np.s_[0, 0, 0], 1e22, "frame 0 is .* out of bounds"),
        (np.s_[0, 0, 0], -1e12, "frame 0 is .* out of bounds"),
    ],
)
def test_frames_that_cannot_be_used_are_named(frames, where, value, message):
    frames[where] = value
    with pytest.raises(DataError, match=rf"^a: {message}"):
        validate(frames, "a")


def test_frames_too_few_too_small_or_too_faint_are_refused(frames):
    for some, message in (
        (frames, r"3 frame\(s\), but this needs at least 8"),
        (frames[:, :15], "15 x 24 px is too small; at least 16"),
        (frames * np.float32(1e-30), "out of bounds"),
    ):
        with pytest.raises(DataError, match=message):
            validate(some, "a", needs=8 if some is frames else 1)


def test_a_span_that_single_precision_does_not_resolve_is_refused(frames):
    faint = 1000 * (1 + 1e-9 * frames.astype(float) / np.ptp(frames))
    with pytest.raises(DataError, match=r"^a: frames span .* single precision does not resolve"):
        selected_in_float32(faint, None, "a")
    faint[:, :4] = np.nan
    faint[:-1] = 1000.1  # constant: left out, if enough others are there
    assert np.ptp(selected_in_float32(faint, None, "a")[0, 4:]) == 0
    found = selected_in_float32(frames.astype(float), None, "a")
    np.testing.assert_array_equal(found, frames)


def test_crop_takes_rows_then_columns(frames):
    np.testing.assert_array_equal(crop(frames, [1, 18, 3, 24]), frames[:, 1:18, 3:24])


@pytest.mark.parametrize(
    ("box", "message"),
    [
        ([0, 21, 0, 24], "not inside the frame of 20 x 24 px"),
        ([-1, 18, 0, 24], "not inside"),
        ([0, 20, 24, 3], "not inside"),
        ([5, 5, 0, 24], "not inside"),
        ([0, 20], "four numbers"),
        ([0, 15, 0, 24], "15 x 24 px is too small"),
    ],
)
def test_a_crop_that_does_not_fit_says_why(frames, box, message):
    with pytest.raises(DataError, match=message):
        crop(frames, box)


def counts(shape=(4, 40, 48)):
    return np.random.default_rng(0).normal(8000, 300, shape).astype(np.float32)


def test_zeros_far_below_all_counts_are_lost_samples_and_others_are_not():
    frames = counts()
    frames[1, 20:24], frames[2, 5, 7] = 0, 0
    assert np.array_equal(unrecorded_samples(frames), frames == 0)
    assert not unrecorded_samples(np.where(frames == 0, 0, frames - 8000)).any()
    assert not unrecorded_samples(np.clip(frames - 8000, 0, None)).any()


def test_bars_at_the_edge_are_empty_and_a_line_within_or_one_that_changes_is_not():
    frames = counts()
    frames[:, :6], frames[:, -3:], frames[:, :, :5], frames[:, 20], frames[0, :, -1] = 16, 16, 16, 16, 16
    expected = np.zeros(frames.shape, bool)
    expected[:, :6] = expected[:, -3:] = expected[:, :, :5] = True
    assert np.array_equal(unrecorded_samples(frames), expected)


def test_lost_rows_are_so_beside_bars_too():
    frames = counts()
    frames[:, :6], frames[2, 20:24] = 16, 0
    expected = np.zeros(frames.shape, bool)
    expected[:, :6] = expected[2, 20:24] = True
    assert np.array_equal(unrecorded_samples(frames), expected)


def test_a_sky_below_the_range_is_neither_a_bar_nor_lost():
    frames = counts()
    for k, sky in enumerate((9, 12, 10, 14)):
        frames[k, :sky] = 0
        frames[k, sky, :20] = 0
    assert not unrecorded_samples(frames).any()
    assert not unrecorded_samples(np.where(frames == 0, 16383, frames)).any()
    frames[2, 30:33], frames[:, 20:26, 30:36] = 0, 0  # a packet, and a dead block
    lost = np.zeros(frames.shape, bool)
    lost[2, 30:33] = lost[:, 20:26, 30:36] = True
    assert np.array_equal(unrecorded_samples(frames), lost)
