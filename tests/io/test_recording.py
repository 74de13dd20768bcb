"""Recordings written frame by frame."""

import numpy as np
import pytest
import recordings
import tifffile

from deepir.errors import DataError
from deepir.io import output, read_frames
from deepir.io.radiometry import Linear, unit_metadata


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_tiff_of_many_pages_says_what_its_values_are(tmp_path, burst, dtype):
    with output.tiff(tmp_path / "a.tif", np.dtype(dtype), unit_metadata(Linear(0.04))) as write:
        for frame in burst:
            write(frame.astype(np.float32))
    read = read_frames(tmp_path / "a.tif")
    assert (read.dtype, read.radiometry) == (np.dtype(dtype).name, Linear(0.04))
    np.testing.assert_array_equal(read.frames, burst)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        assert len(tiff.pages) == 3


def test_whole_numbers_are_rounded_and_cut():
    values = np.array([-3.0, 1.5, 2.5, 7.6, 1e6, np.nan], np.float32)
    assert output.cast(values, np.dtype(np.uint16)).tolist() == [0, 2, 2, 8, 65535, 0]
    assert output.cast(values, np.dtype(np.float32)) is values


def test_a_recording_keeps_its_type_where_that_can_hold_it():
    assert output.output_type(np.dtype(">u2"), rounded=True) == np.uint16
    for dtype, rounded in (("u2", False), ("i4", True), ("f8", True)):
        assert output.output_type(np.dtype(dtype), rounded=rounded) == np.float32


def test_a_broken_off_recording_leaves_nothing(tmp_path, burst):
    def broken():
        with output.tiff(tmp_path / "a.tif", np.dtype(np.uint16), {}) as write:
            write(burst[0])
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        broken()
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("tones", ["percentile", "clahe"])
def test_a_film_can_be_looked_at(tmp_path, tones):
    pytest.importorskip("av")
    ramp = np.tile(np.linspace(7000, 9000, 65), (3, 49, 1)).astype(np.float32)
    with output.mp4(tmp_path / "a.mp4", "white-hot", tones) as write:
        for frame in ramp:
            write(frame)
    shown = read_frames(tmp_path / "a.mp4").frames
    assert shown.shape == (3, 48, 64)
    assert np.corrcoef(shown[1].ravel(), ramp[1, :48, :64].ravel())[0, 1] > 0.98


def test_a_palette_is_seen_in_a_film(tmp_path):
    pytest.importorskip("av")
    with output.mp4(tmp_path / "a.mp4", "ironbow", "percentile") as write:
        write(np.tile(np.linspace(0, 1, 64), (48, 1)))
    with pytest.raises(DataError, match="carries no radiometry"):
        read_frames(tmp_path / "a.mp4")


def test_a_grey_film_that_a_codec_has_tinted_slightly_is_read(tmp_path):
    """The colour difference of all pixels is one below neutral, as in an MPEG-4 film of a thermal camera."""
    pytest.importorskip("av")
    ramp = np.tile(np.linspace(40, 200, 64).astype(np.uint8), (48, 1))
    picture = np.vstack((ramp, np.full((24, 64), 127, np.uint8)))
    recordings.film(tmp_path / "a.mkv", picture[None], stored="yuv420p", size=(48, 64))
    shown = read_frames(tmp_path / "a.mkv").frames[0]
    assert not np.isnan(shown).any()
    assert np.corrcoef(shown.ravel(), ramp.ravel())[0, 1] > 0.999


def test_another_name_is_answered_with_those_there_are(tmp_path):
    with pytest.raises(DataError, match=r"a\.avi: a recording is written as \.tif .* or \.mp4"):
        output.open_writer(tmp_path / "a.avi", np.dtype(np.uint16), {}, "white-hot", "percentile")
