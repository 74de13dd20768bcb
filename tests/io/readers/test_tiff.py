import struct

import numpy as np
import pytest
import recordings
import tifffile

from deepir.errors import DataError
from deepir.io import read_frames, stream_frames


def test_pages_appended_one_by_one_are_one_burst(tmp_path, burst):
    for frame in burst:
        tifffile.imwrite(tmp_path / "a.tif", frame, append=True)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames, burst)


def test_imagej_stacks_are_read_whole(tmp_path, burst):
    tifffile.imwrite(tmp_path / "a.tif", burst, imagej=True)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames, burst)


def test_float_tiff_is_exact(tmp_path, burst):
    kelvin = burst.astype(np.float32) / 64 + 273.15
    tifffile.imwrite(tmp_path / "a.tif", kelvin, compression="zlib", photometric="minisblack")
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames, kelvin)


def test_pages_of_different_size_are_an_error(tmp_path):
    for size in (20, 24):
        tifffile.imwrite(tmp_path / "a.tif", np.zeros((size, size), np.uint16), append=True)
    with pytest.raises(DataError, match=r"pages differ in size: \(20, 20\) and \(24, 24\)"):
        read_frames(tmp_path / "a.tif")


def test_grey_stored_as_rgb_tiff_is_grey(tmp_path, burst):
    rgb = np.stack([burst[0]] * 3, axis=-1)
    tifffile.imwrite(tmp_path / "a.tif", rgb, photometric="rgb")
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames, burst[:1])


def test_colour_tiff_is_refused(tmp_path, burst):
    tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(burst, 0, -1), photometric="rgb")
    with pytest.raises(DataError, match="radiometry"):
        read_frames(tmp_path / "a.tif")


def test_three_frames_that_tifffile_took_for_colour_planes_are_three_frames(tmp_path, burst):
    tifffile.imwrite(tmp_path / "a.tif", burst, photometric="rgb", planarconfig="separate")
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames, burst)


def test_palette_tiff_carries_no_radiometry(tmp_path, burst):
    colours = np.zeros((3, 256), np.uint16)
    tifffile.imwrite(tmp_path / "a.tif", burst[0].astype(np.uint8), photometric="palette", colormap=colours)
    with pytest.raises(DataError, match="radiometry"):
        read_frames(tmp_path / "a.tif")


def test_a_tiff_that_claims_a_huge_picture_is_refused_at_once(tmp_path, burst):
    tifffile.imwrite(tmp_path / "a.tif", burst[0], compression="zlib")
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as tiff:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tiff.pages[0].tags[tag].overwrite(10**6, dtype="I")
    with pytest.raises(DataError, match="declares 2,000,000,000,000 bytes"):
        read_frames(tmp_path / "a.tif")


def test_a_truncated_tiff_is_not_filled_up_with_zeros(tmp_path, burst):
    for save in (recordings.tiff, recordings.big_tiff, recordings.lzw_tiff):
        save(tmp_path / "a.tif", burst)
        content = (tmp_path / "a.tif").read_bytes()
        for lost in (20, 200, len(content) // 2):
            (tmp_path / "a.tif").write_bytes(content[:-lost])
            with pytest.raises(DataError, match="truncated"):
                read_frames(tmp_path / "a.tif")


@pytest.mark.parametrize("cycle", ["next", "SubIFDs"])
def test_directories_in_a_circle_are_damage(tmp_path, cycle):
    """A library that follows them would never end."""
    values = [(256, 32), (257, 24), (258, 16), (259, 1), (262, 1), (273, 8), (277, 1), (278, 24), (279, 1536)]
    tags = [(tag, 4, 1, value) for tag, value in values] + [(330, 13, 1, 1544 if cycle == "SubIFDs" else 0)]
    directory = struct.pack("<H", len(tags)) + b"".join(struct.pack("<HHII", *tag) for tag in tags)
    following = struct.pack("<I", 1544 if cycle == "next" else 0)
    (tmp_path / "a.tif").write_bytes(b"II*\0" + struct.pack("<I", 1544) + bytes(1536) + directory + following)
    with pytest.raises(DataError, match="reached twice"):
        read_frames(tmp_path / "a.tif")


@pytest.mark.parametrize("options", [{}, {"bigtiff": True}, {"subifds": 1}])
def test_directories_that_end_are_followed(tmp_path, options):
    frames = np.arange(20 * 24, dtype=np.uint16).reshape(20, 24)
    with tifffile.TiffWriter(tmp_path / "a.tif", bigtiff=options.get("bigtiff", False)) as tiff:
        tiff.write(frames, subifds=options.get("subifds", 0))
        if "subifds" in options:
            tiff.write(frames[::2, ::2], subfiletype=1)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames[0], frames)


@pytest.mark.parametrize("kind", [np.float32, np.int16, np.uint16])
def test_samples_of_the_value_that_gdals_tag_names_are_lost(tmp_path, burst, kind):
    frames = burst.astype(kind)
    frames[1, 3:6, 4:9] = 77
    options = {"metadata": None, "photometric": "minisblack", "extratags": [(42113, "s", 0, "77", False)]}
    tifffile.imwrite(tmp_path / "a.tif", frames, **options)
    found = read_frames(tmp_path / "a.tif").frames
    assert np.array_equal(np.isnan(found), frames == 77)
    streamed = [np.ma.getmaskarray(each) for each in stream_frames(tmp_path / "a.tif")]
    assert np.array_equal(streamed, frames == 77)


def test_more_samples_than_colours_are_frames_along_the_last_axis(tmp_path, burst):
    tifffile.imwrite(tmp_path / "a.tif", np.moveaxis(np.tile(burst, (3, 1, 1)), 0, -1), planarconfig="contig")
    with pytest.raises(DataError, match=r"data\.axes=hwn reads 9 frames"):
        read_frames(tmp_path / "a.tif")


def test_gdals_nodata_counts_on_whichever_page_it_is(tmp_path, burst):
    frames = burst | 8
    frames[0, :2] = 7
    with tifffile.TiffWriter(tmp_path / "a.tif") as file:
        for number, frame in enumerate(frames):
            tag = [(42113, "s", 0, "7", True)] if number == 1 else []
            file.write(frame, photometric="minisblack", extratags=tag, metadata=None)
    np.testing.assert_array_equal(np.isnan(read_frames(tmp_path / "a.tif").frames), frames == 7)
