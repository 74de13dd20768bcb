"""Samples in another order of bytes, type or order of axes than a file says."""

import numpy as np
import pytest
import tifffile
from recordings import assert_read, stream_frames

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io import read_frames
from deepir.io.inspection.samples import are_swapped, wrapped_type
from deepir.simulate import Settings, simulate


@pytest.fixture(scope="module")
def frames():
    return simulate(None, Settings(n_frames=20, shape=(48, 64), counts=True), seed=3).frames.astype(np.uint16)


def test_swapped_bytes_are_named_with_the_setting_that_mends_them(tmp_path, frames):
    tifffile.imwrite(tmp_path / "a.tif", frames.byteswap(), photometric="minisblack")
    for read in (read_frames, lambda path: list(stream_frames(path))):
        with pytest.raises(DataError, match=r"look swapped.*data\.swap_bytes=true swaps them"):
            read(tmp_path / "a.tif")
    assert_read(tmp_path / "a.tif", frames, swap_bytes=True)
    assert read_frames(tmp_path / "a.tif", swap_bytes=False).frames[0, 0, 0] == frames.byteswap()[0, 0, 0]


def test_a_layout_of_the_wrong_order_of_bytes_is_named(tmp_path, frames):
    (tmp_path / "a.raw").write_bytes(frames.astype(">u2").tobytes())
    with pytest.raises(DataError, match=r"data\.raw\.endian=big"):
        read_frames(tmp_path / "a.raw", raw=Raw(width=64, height=48))


@pytest.mark.parametrize("kind", [np.float32, np.float64, np.int32])
def test_longer_numbers_of_swapped_bytes_are_named_too(frames, kind):
    assert are_swapped(frames.astype(kind).byteswap())
    assert not are_swapped(frames.astype(kind))
    if kind != np.int32:
        assert not are_swapped((frames / 65536).astype(kind))


@pytest.mark.parametrize(
    "change",
    [
        lambda f: f,
        lambda f: f << 2,
        lambda f: (f >> 6) << 8,
        lambda f: (f >> 6).astype(np.uint16),
        lambda f: np.full_like(f, 8000),
        lambda f: f[:, :1],
        lambda f: np.random.default_rng(0).integers(0, 2**16, f.shape).astype(np.uint16),
        lambda f: f.astype(np.int16),
        lambda f: f.astype(np.float32),
    ],
)
def test_right_samples_are_not_taken_for_swapped_ones(frames, change):
    assert not are_swapped(change(frames))


def test_signed_numbers_stay_signed(frames):
    celsius = (frames.astype(int) - int(np.median(frames))).astype(np.int16)
    assert wrapped_type(celsius) is None
    celsius[:, :3] = -32768
    assert wrapped_type(celsius) is None


@pytest.mark.parametrize(
    ("share", "zero", "stored", "said"),
    [
        (0.5, 2**15, np.int16, "counts above 32767 are stored as negative ones"),
        *((share, 0, np.uint16, "counts below zero are stored as large ones") for share in (0.01, 0.3, 0.9)),
    ],
)
def test_counts_that_have_wrapped_are_read_as_they_were(tmp_path, frames, caplog, share, zero, stored, said):
    true = frames.astype(int) - int(np.quantile(frames, share)) + zero
    np.save(tmp_path / "a.npy", true.astype(stored))
    assert_read(tmp_path / "a.npy", true)
    assert said in caplog.text


def test_a_hot_object_and_pixels_at_full_scale_have_not_wrapped(frames):
    hot = frames.copy()
    hot[:, 10:20, 10:20] = 60000
    hot[:, 5, 5:9] = 65535
    assert wrapped_type(hot) is None


def test_bytes_between_and_after_frames_are_skipped(tmp_path, frames):
    (tmp_path / "a.raw").write_bytes(b"".join(each.tobytes() + b"12345" for each in frames) + b"end")
    with pytest.raises(DataError, match=r"data\.raw\.trailer="):
        read_frames(tmp_path / "a.raw", raw=Raw(width=64, height=48))
    assert_read(tmp_path / "a.raw", frames, raw=Raw(width=64, height=48, gap=5, trailer=3))
    (tmp_path / "b.raw").write_bytes(frames[0].tobytes() + b"end")
    assert_read(tmp_path / "b.raw", frames[:1], raw=Raw(width=64, height=48, trailer=3))


@pytest.mark.parametrize(("width", "height"), [(48, 64), (128, 24), (96, 32), (64, 48)])
def test_a_wrong_width_is_named_with_the_one_at_which_rows_continue(tmp_path, frames, caplog, width, height):
    (tmp_path / "a.raw").write_bytes(frames.tobytes())
    read_frames(tmp_path / "a.raw", raw=Raw(width=width, height=height))
    assert ("Try data.raw.width=64 data.raw.height=48" in caplog.text) == (width != 64)


@pytest.mark.parametrize("count", [8, 20])
@pytest.mark.parametrize("axes", ["hwn", "wnh"])
def test_a_turned_array_is_asked_for_with_the_setting_that_reads_it(tmp_path, frames, axes, count):
    some = frames[:count]
    np.savez(tmp_path / "a.npz", frames=some.transpose(["nhw".index(each) for each in axes]))
    for read in (read_frames, lambda path: list(stream_frames(path))):
        with pytest.raises(DataError, match=f"or {count} frames counted along another axis.*data.axes={axes} "):
            read(tmp_path / "a.npz")
    assert_read(tmp_path / "a.npz", some, axes=axes)


@pytest.mark.parametrize("moving", [True, False])
def test_a_turned_array_of_more_frames_than_rows_is_asked_for_too(tmp_path, frames, moving):
    noise = np.random.default_rng(0).normal(0, 3, (100, 48, 64))
    many = (frames[np.arange(100) % (20 if moving else 1)] + noise).astype(np.uint16)
    np.save(tmp_path / "a.npy", np.moveaxis(many, 0, -1))
    with pytest.raises(DataError, match=r"data\.axes=hwn reads 100 frames"):
        read_frames(tmp_path / "a.npy")
    np.save(tmp_path / "b.npy", many)
    np.testing.assert_array_equal(read_frames(tmp_path / "b.npy").frames, many)


@pytest.mark.parametrize("shape", [(60, 80, 96), (120, 160, 100), (200, 30, 130)])
def test_a_recording_whose_sides_look_like_others_is_read_by_its_pattern(tmp_path, shape):
    """60 frames of 80 x 96 px, and not 96 frames of 60 x 80 px, a detector's sides."""
    rng = np.random.default_rng(0)
    recording = (8000 + rng.normal(0, 40, shape[1:]) + rng.normal(0, 5, shape)).astype(np.uint16)
    np.save(tmp_path / "a.npy", recording)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npy").frames, recording)
    np.save(tmp_path / "b.npy", np.moveaxis(recording, 0, -1))
    with pytest.raises(DataError, match=rf"data\.axes=hwn reads {shape[0]} frames"):
        read_frames(tmp_path / "b.npy")
