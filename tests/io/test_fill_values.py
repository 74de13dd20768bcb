"""Samples that a file calls lost, values that stand for such, and colours in a grey picture have no value."""

import numpy as np
import pytest
import recordings
import tifffile
from PIL import Image

from deepir.io import read_frames
from deepir.io.inspection.samples import FILL_VALUES, lost_samples


def assert_lost(path, expected):
    """These samples of a file, and no others, are lost, whole and frame by frame."""
    np.testing.assert_array_equal(np.isnan(read_frames(path).frames), expected)
    np.testing.assert_array_equal([np.ma.getmaskarray(frame) for frame in recordings.stream_frames(path)], expected)


@pytest.fixture
def celsius():
    return np.random.default_rng(0).uniform(-20, 40, (3, 24, 32)).astype(np.float32)


def tiff_with_gdals_tag_on(*pages):
    def write(path, frames):
        with tifffile.TiffWriter(path) as file:
            for number, frame in enumerate(frames):
                tag = [(42113, "s", 0, "-1", True)] if number in pages else []
                file.write(frame, photometric="minisblack", extratags=tag, metadata=None)

    return write


def netcdf(**attributes):
    def write(path, frames):
        h5py = pytest.importorskip("h5py")
        with h5py.File(path, "w") as file:
            file.create_dataset("brightness", data=frames).attrs.update(attributes)

    return write


SAID = {
    "ENVI": ("a.img", lambda p, f: recordings.envi(p, f, extra="data ignore value = -1\n")),
    "GDAL": ("a.tif", tiff_with_gdals_tag_on(0)),
    "GDAL, floats": ("a.tif", lambda p, f: tiff_with_gdals_tag_on(0)(p, f.astype("f4"))),
    "GDAL, second page": ("a.tif", tiff_with_gdals_tag_on(1)),
    "NetCDF, fill": ("a.nc", netcdf(_FillValue=np.int16(-1))),
    "NetCDF, missing": ("a.nc", netcdf(missing_value=np.array([-1, -2], np.int16))),
    "NetCDF, range": ("a.nc", netcdf(valid_range=np.array([0, 32000], np.int16))),
    "NetCDF, least": ("a.nc", netcdf(valid_min=np.int16(0))),
}


@pytest.mark.parametrize("what", SAID)
def test_samples_that_a_file_calls_lost_are_lost(tmp_path, burst, what):
    name, write = SAID[what]
    frames = burst.astype(np.int16)
    frames[1, 3:6, 4:9] = -1
    write(tmp_path / name, frames)
    assert_lost(tmp_path / name, frames == -1)


def test_unsigned_counts_of_netcdf_are_unsigned(tmp_path, burst):
    frames = burst + np.uint16(25000)
    netcdf(_Unsigned="true")(tmp_path / "a.nc", frames.view(np.int16))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.nc").frames, frames)


@pytest.mark.parametrize("value", FILL_VALUES)
def test_a_fill_value_far_from_all_else_is_lost(tmp_path, celsius, value):
    celsius[1, :4] = value
    np.save(tmp_path / "a.npy", celsius)
    assert_lost(tmp_path / "a.npy", celsius == celsius[1, 0, 0])


def test_the_largest_count_far_from_all_others_is_lost_in_whichever_frame(tmp_path):
    counts = np.random.default_rng(0).integers(7000, 9000, (3, 24, 32)).astype(np.uint16)
    counts[1, 5:9] = 65535
    np.savez(tmp_path / "a.npz", frames=counts)
    assert_lost(tmp_path / "a.npz", counts == 65535)


def test_values_among_the_others_are_values(celsius):
    numbers = np.random.default_rng(0).integers(-12000, 12000, (3, 24, 32)).astype(np.float32)
    numbers[0, :2] = -9999
    assert lost_samples(numbers, np.dtype(np.int16)) is None
    saturated = np.random.default_rng(0).integers(7000, 70000, (3, 24, 32)).clip(0, 65535).astype(np.uint16)
    assert lost_samples(saturated, saturated.dtype) is None
    unsigned = np.where(celsius < 0, np.float32(1e20), celsius)  # such counts have no fill value
    assert lost_samples(unsigned, np.dtype(np.uint16)) is None


def test_zeros_below_all_other_floats_are_lost_and_others_are_not(celsius):
    celsius[0, :4] = 0
    assert lost_samples(celsius, celsius.dtype) is None
    warm = np.where(celsius == 0, 0, celsius + 40)
    np.testing.assert_array_equal(lost_samples(warm, warm.dtype), warm == 0)


def test_two_fill_values_are_both_lost(celsius):
    celsius[0, 0], celsius[1, 1] = -9999, -32768
    assert lost_samples(celsius, celsius.dtype).sum() == 64


def test_a_coloured_marker_has_no_value_in_the_frame_where_it_is(tmp_path):
    picture = np.full((40, 40, 3), 90, np.uint8)
    Image.fromarray(picture).save(tmp_path / "0.png")
    picture[3:6, 4:7] = (0, 255, 0)
    Image.fromarray(picture).save(tmp_path / "1.png")
    lost = np.isnan(read_frames(tmp_path).frames)
    assert lost[1, 3:6, 4:7].all()
    assert lost.sum() == 9


def test_the_colours_of_a_mark_are_lost_where_a_lossy_codec_has_spread_them(tmp_path):
    ramp = np.repeat(np.tile(np.arange(20, 180, dtype=np.uint8), (120, 1))[..., None], 3, axis=-1)
    ramp[60, 74:84], ramp[56:64, 79] = (255, 0, 0), (255, 0, 0)
    Image.fromarray(ramp).save(tmp_path / "a.jpg", quality=85)
    found = read_frames(tmp_path / "a.jpg").frames[0]
    assert np.isnan(found[60, 74:84]).all()
    assert np.isnan(found).mean() < 0.05
