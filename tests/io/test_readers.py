import hashlib
import os
import pickle
import subprocess
import sys
import zipfile
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import tifffile
from PIL import Image

from deepir.errors import DataError
from deepir.io import read_frames, readers


def save_npz(path, burst):
    np.savez_compressed(path, frames=burst)


def save_tiff(path, burst):
    tifffile.imwrite(path, burst, photometric="minisblack")


def save_big_tiff(path, burst):
    tifffile.imwrite(path, burst, photometric="minisblack", bigtiff=True, byteorder=">")


def save_lzw(path, burst):
    tifffile.imwrite(path, burst, compression="lzw", photometric="minisblack")


def save_folder(path, burst):
    path.mkdir()
    for k, frame in enumerate(burst):
        Image.fromarray(frame).save(path / f"frame{k + 8}.png")


WRITERS = {
    "burst.npz": save_npz,
    "burst.npy": np.save,
    "burst.tif": save_tiff,
    "big.tif": save_big_tiff,
    "lzw.tiff": save_lzw,
    "folder": save_folder,
}


@pytest.mark.parametrize("name", WRITERS)
def test_every_format_gives_the_same_frames_exactly(tmp_path, burst, name):
    WRITERS[name](tmp_path / name, burst)
    read = read_frames(tmp_path / name)
    assert read.frames.dtype == np.float32
    assert read.dtype == "uint16"
    assert read.source == str(tmp_path / name)
    np.testing.assert_array_equal(read.frames, burst)


@pytest.mark.parametrize("name", ["burst.npz", "burst.npy", "burst.tif"])
def test_contents_decide_the_format_and_not_the_name(tmp_path, burst, name):
    WRITERS[name](tmp_path / name, burst)
    (tmp_path / name).rename(tmp_path / "burst.png")
    np.testing.assert_array_equal(read_frames(tmp_path / "burst.png").frames, burst)


def test_the_digest_is_that_of_the_file(tmp_path, burst):
    np.save(tmp_path / "a.npy", burst)
    assert (
        read_frames(tmp_path / "a.npy").sha256
        == hashlib.sha256((tmp_path / "a.npy").read_bytes()).hexdigest()
    )


def test_the_digest_of_a_folder_changes_with_any_of_its_files(tmp_path, burst):
    save_folder(tmp_path / "f", burst)
    before = read_frames(tmp_path / "f").sha256
    Image.fromarray(burst[0]).save(tmp_path / "f" / "frame9.png")
    assert read_frames(tmp_path / "f").sha256 != before


def test_nothing_here_imports_torch():
    code = "import sys, deepir.io, deepir.io.readers as r; r.all_readers(); sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_a_new_format_is_one_new_file_and_comes_before_general_readers(tmp_path, monkeypatch):
    (tmp_path / "thermal_jpeg.py").write_text(
        "import numpy as np\n"
        "SUFFIXES = ('.rjpg',)\n"
        "def sniff(head, path): return head.startswith(b'\\xff\\xd8\\xff\\xe1FLIR')\n"
        "def read(path, key): return np.full((20, 24), 7.0)\n"
    )
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff\xe1FLIR")
    monkeypatch.setattr(readers, "__path__", [*readers.__path__, str(tmp_path)])
    readers.all_readers.cache_clear()
    try:
        assert (read_frames(tmp_path / "a.jpg").frames == 7).all()
        assert ".rjpg" in readers.suffixes()
    finally:
        readers.all_readers.cache_clear()
        sys.modules.pop("deepir.io.readers.thermal_jpeg", None)


# Types and shapes


@pytest.mark.parametrize("shape", [(20, 24), (1, 20, 24), (1, 1, 20, 24), (1, 20, 24, 1)])
def test_one_frame_may_be_written_in_four_ways(tmp_path, burst, shape):
    np.save(tmp_path / "a.npy", burst[0].reshape(shape))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npy").frames, burst[:1])


@pytest.mark.parametrize("shape", [(480,), (2, 2, 12, 10), (0, 20, 24)])
def test_other_shapes_are_named(tmp_path, shape):
    np.save(tmp_path / "a.npy", np.zeros(shape))
    with pytest.raises(DataError, match=r"a\.npy: an array of shape \(.*expected \(frames, height, width\)"):
        read_frames(tmp_path / "a.npy")


@pytest.mark.parametrize("dtype", [">u2", "i4", "u8", "f2", "f8", ">f4"])
def test_numbers_of_any_type_become_float32(tmp_path, burst, dtype):
    stored = (burst // 8).astype(dtype)
    np.save(tmp_path / "a.npy", stored)
    read = read_frames(tmp_path / "a.npy")
    assert read.dtype == np.dtype(dtype).name
    np.testing.assert_array_equal(read.frames, stored.astype(np.float32))


def test_what_float32_cannot_hold_becomes_infinite(tmp_path):
    np.save(tmp_path / "a.npy", np.full((20, 20), 1e300))
    assert np.isinf(read_frames(tmp_path / "a.npy").frames).all()


@pytest.mark.parametrize("dtype", [bool, complex, "U4", "M8[s]"])
def test_what_is_no_number_is_refused(tmp_path, dtype):
    np.save(tmp_path / "a.npy", np.zeros((20, 20), dtype))
    with pytest.raises(DataError, match="integers or real numbers"):
        read_frames(tmp_path / "a.npy")


@pytest.mark.parametrize("save", [np.save, np.savez], ids=["npy", "npz"])
def test_pickles_are_never_loaded(tmp_path, save):
    class Bomb:
        def __reduce__(self):
            return (os.mkdir, (str(tmp_path / "owned"),))

    save(tmp_path / "a.npz", np.array([Bomb()], dtype=object))
    file = next(tmp_path.iterdir())
    with pytest.raises(DataError, match="never loaded"):
        read_frames(file, key="arr_0")
    (tmp_path / "raw.npy").write_bytes(pickle.dumps(Bomb()))
    with pytest.raises(DataError, match="not a format"):
        read_frames(tmp_path / "raw.npy")
    assert not (tmp_path / "owned").exists()


# npz


def test_the_only_picture_in_an_npz_needs_no_key(tmp_path, burst):
    np.savez(tmp_path / "a.npz", raw=burst, exposure=8.3, times=np.arange(3))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npz").frames, burst)


def test_frames_are_preferred_in_an_npz(tmp_path, burst):
    np.savez(tmp_path / "a.npz", frames=burst, shutter=burst[0])
    assert len(read_frames(tmp_path / "a.npz").frames) == 3
    assert len(read_frames(tmp_path / "a.npz", key="shutter").frames) == 1


def test_several_candidates_are_listed_with_their_shapes(tmp_path, burst):
    np.savez(tmp_path / "a.npz", raw=burst, cal=burst[0])
    with pytest.raises(DataError, match=r"\(data.key\). Arrays: cal \(20, 24\), raw \(3, 20, 24\)"):
        read_frames(tmp_path / "a.npz")


def test_a_misspelt_key_is_answered_with_the_nearest(tmp_path, burst):
    save_npz(tmp_path / "a.npz", burst)
    with pytest.raises(DataError, match="no array 'frmes'; did you mean 'frames'"):
        read_frames(tmp_path / "a.npz", key="frmes")


def test_a_zip_without_arrays_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "nothing")
    with pytest.raises(DataError, match="without NumPy arrays"):
        read_frames(tmp_path / "a.npz")


# TIFF


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


# Pictures


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_grey_pngs_keep_every_bit_in_any_number_of_channels(tmp_path, burst, dtype, channels):
    grey = burst[0].astype(dtype)
    pixels = np.stack([grey] * channels, axis=-1) if channels > 1 else grey
    (tmp_path / "a.png").write_bytes(imagecodecs.png_encode(pixels))
    read = read_frames(tmp_path / "a.png")
    assert read.dtype == np.dtype(dtype).name
    np.testing.assert_array_equal(read.frames[0], grey)


@pytest.mark.parametrize("name", ["a.bmp", "a.jpg"])
def test_other_grey_pictures_are_read(tmp_path, name):
    ramp = np.tile(np.arange(0, 240, 10, np.uint8), (20, 1))
    Image.fromarray(ramp).save(tmp_path / name, quality=100)
    np.testing.assert_allclose(read_frames(tmp_path / name).frames[0], ramp, atol=6)


@pytest.mark.parametrize("name", ["a.png", "a.bmp", "a.jpg"])
def test_a_palette_picture_carries_no_radiometry(tmp_path, name):
    hot = np.zeros((20, 24, 3), np.uint8)
    hot[..., 0] = np.arange(24) * 10
    Image.fromarray(hot).save(tmp_path / name)
    with pytest.raises(DataError, match=r"palette picture carries no radiometry.*16-bit"):
        read_frames(tmp_path / name)


def test_a_coloured_marker_in_a_grey_picture_has_no_value(tmp_path):
    picture = np.full((40, 40, 3), 90, np.uint8)
    picture[3:6, 4:7] = (0, 255, 0)
    Image.fromarray(picture).save(tmp_path / "a.png")
    frame = read_frames(tmp_path / "a.png").frames[0]
    assert np.isnan(frame[3:6, 4:7]).all()
    assert np.isnan(frame).sum() == 9


# Folders and globs


def test_folders_are_in_natural_order_and_leave_out_what_is_no_picture(tmp_path, burst):
    save_folder(tmp_path / "f", burst)  # frame8, frame9, frame10
    (tmp_path / "f" / "notes.txt").write_text("outside, windy")
    (tmp_path / "f" / ".hidden.png").write_bytes(b"no picture")
    (tmp_path / "f" / "Thumbs.db").touch()
    np.testing.assert_array_equal(read_frames(tmp_path / "f").frames, burst)


def test_globs_choose_files(tmp_path, burst):
    save_folder(tmp_path / "f", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "f" / "frame?.png").frames, burst[:2])


def test_globs_work_from_the_current_folder(tmp_path, burst, monkeypatch):
    save_folder(tmp_path / "f", burst)
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(read_frames("f/*.png").frames, burst)


def test_a_file_with_brackets_in_its_name_is_a_file(tmp_path, burst):
    np.save(tmp_path / "burst[1].npy", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "burst[1].npy").frames, burst)


def test_a_marker_in_one_of_many_pictures_is_masked_there_only(tmp_path):
    for k in range(2):
        picture = np.full((20, 20, 3), 90, np.uint8)
        picture[2, 2, 0] += k
        Image.fromarray(picture).save(tmp_path / f"{k}.png")
    assert np.isnan(read_frames(tmp_path).frames).sum(axis=(1, 2)).tolist() == [0, 1]


def test_sizes_that_differ_are_named_with_both_files(tmp_path, burst):
    Image.fromarray(burst[0]).save(tmp_path / "a.png")
    Image.fromarray(burst[0, :18]).save(tmp_path / "b.png")
    with pytest.raises(DataError, match=r"a\.png is 20 x 24, b\.png is 18 x 24"):
        read_frames(tmp_path)


def test_types_that_differ_are_not_mixed(tmp_path, burst):
    Image.fromarray(burst[0]).save(tmp_path / "a.png")
    Image.fromarray(burst[0].astype(np.uint8)).save(tmp_path / "b.png")
    with pytest.raises(DataError, match=r"a\.png is uint16, b\.png is uint8"):
        read_frames(tmp_path)


def test_a_damaged_picture_in_a_folder_is_an_error_and_not_a_missing_frame(tmp_path, burst):
    save_folder(tmp_path / "f", burst)
    (tmp_path / "f" / "frame9.png").write_bytes(b"")
    with pytest.raises(DataError, match=r"frame9\.png: the file is empty"):
        read_frames(tmp_path / "f")


def test_folders_without_pictures_and_globs_without_matches_say_so(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(DataError, match=r"no pictures in this folder \(\.bmp"):
        read_frames(tmp_path)
    with pytest.raises(DataError, match="no file matches"):
        read_frames(tmp_path / "*.png")


# Selecting


@pytest.mark.parametrize(
    ("select", "expected"),
    [
        (None, [0, 1, 2]),
        (2, [0, 1]),
        ("2", [0, 1]),
        ("1:3", [1, 2]),
        ("::2", [0, 2]),
        ("-1:", [2]),
        ("::-1", [2, 1, 0]),
        ([2, 0], [2, 0]),
        ([-1], [2]),
    ],
)
def test_select_takes_counts_slices_and_lists(tmp_path, burst, select, expected):
    np.save(tmp_path / "a.npy", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npy", select=select).frames, burst[expected])


@pytest.mark.parametrize(
    "select",
    [0, 4, -1, "4", "2:2", "3:", "0:4", "::0", "1:2:3:4", "a", "1.5", [], [3], [-4], [True], True, 1.5],
)
def test_a_selection_that_does_not_fit_says_how_many_frames_there_are(tmp_path, burst, select):
    np.save(tmp_path / "a.npy", burst)
    with pytest.raises(DataError, match="does not fit its 3 frames"):
        read_frames(tmp_path / "a.npy", select=select)


# Files that cannot be read


def test_a_missing_file_is_answered_with_the_nearest_names(tmp_path, burst):
    np.save(tmp_path / "flight_07.npy", burst)
    with pytest.raises(DataError, match=r"no such file or folder; did you mean 'flight_07\.npy'\?"):
        read_frames(tmp_path / "flight_7.npy")
    with pytest.raises(DataError, match="there is no folder"):
        read_frames(tmp_path / "nowhere" / "a.npy")


def test_an_empty_file_says_so(tmp_path):
    (tmp_path / "a.npy").touch()
    with pytest.raises(DataError, match="the file is empty"):
        read_frames(tmp_path / "a.npy")


def test_an_unknown_format_lists_those_there_are(tmp_path):
    (tmp_path / "a.npz").write_text("frames")
    with pytest.raises(DataError, match=r"not a format that deepir reads .*\.npy, \.npz, \.png, \.tif"):
        read_frames(tmp_path / "a.npz")


def test_a_file_without_permission_says_so(tmp_path, burst, monkeypatch):
    def deny(*_):
        raise PermissionError

    np.save(tmp_path / "a.npy", burst)
    monkeypatch.setattr(Path, "open", deny)  # root, as which containers run, may read everything
    with pytest.raises(DataError, match="no permission"):
        read_frames(tmp_path / "a.npy")


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes here")
def test_a_pipe_does_not_block(tmp_path):
    os.mkfifo(tmp_path / "pipe.npy")
    with pytest.raises(DataError, match="not an ordinary file"):
        read_frames(tmp_path / "pipe.npy")


def test_an_npy_that_claims_a_huge_array_is_refused_at_once(tmp_path):
    header = {"descr": "<f4", "fortran_order": False, "shape": (10**6, 1000, 1000)}
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.write(bytes(100))
    with pytest.raises(DataError, match=r"declares 4,000,000,000,000 bytes of data but holds 100"):
        read_frames(tmp_path / "a.npy")
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.write(tmp_path / "a.npy", "frames.npy")
    with pytest.raises(DataError, match="4,000,000,000,000"):
        read_frames(tmp_path / "a.npz")


def test_a_tiff_that_claims_a_huge_picture_is_refused_at_once(tmp_path, burst):
    tifffile.imwrite(tmp_path / "a.tif", burst[0], compression="zlib")
    with tifffile.TiffFile(tmp_path / "a.tif", mode="r+") as tiff:
        for tag in ("ImageWidth", "ImageLength", "RowsPerStrip"):
            tiff.pages[0].tags[tag].overwrite(10**6, dtype="I")
    with pytest.raises(DataError, match="declares 2,000,000,000,000 bytes"):
        read_frames(tmp_path / "a.tif")


def test_a_png_that_claims_a_huge_picture_is_refused_at_once(tmp_path, burst):
    content = bytearray(imagecodecs.png_encode(burst[0]))
    content[16:24] = (2**31 - 1).to_bytes(4) * 2
    (tmp_path / "a.png").write_bytes(content)
    with pytest.raises(DataError, match="declares"):
        read_frames(tmp_path / "a.png")


def test_a_zip_bomb_is_refused_by_its_declared_size(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("frames.npy", b"x")
    content = (tmp_path / "a.npz").read_bytes()
    central = content.index(b"PK\x01\x02")
    bomb = content[: central + 24] + (2**32 - 2).to_bytes(4, "little") + content[central + 28 :]
    (tmp_path / "a.npz").write_bytes(bomb)
    with pytest.raises(DataError, match="declares 4,294,967,294 bytes"):
        read_frames(tmp_path / "a.npz")


def test_more_than_eight_gib_are_not_read_at_once(tmp_path):
    header = {"descr": "|u1", "fortran_order": False, "shape": (9, 2**15, 2**15)}
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + 9 * 2**30)  # sparse: takes no room
    with pytest.raises(DataError, match=r"9\.0 GiB of data; at most 8 GiB"):
        read_frames(tmp_path / "a.npy")


def test_a_truncated_tiff_is_not_filled_up_with_zeros(tmp_path, burst):
    for save in (save_tiff, save_big_tiff, save_lzw):
        save(tmp_path / "a.tif", burst)
        content = (tmp_path / "a.tif").read_bytes()
        for lost in (20, 200, len(content) // 2):
            (tmp_path / "a.tif").write_bytes(content[:-lost])
            with pytest.raises(DataError, match="truncated"):
                read_frames(tmp_path / "a.tif")


# Real data


@pytest.mark.parametrize(
    ("name", "shape", "dtype"),
    [
        ("a65/a65_frames_000-009.npz", (10, 512, 640), "uint16"),
        ("dji_h30t/H30T_DJI_0001_R_1280x1024_u16.npz", (1, 1024, 1280), "uint16"),
        ("radiometric_jpg/duo_pro_r_radiometric.tiff", (1, 512, 640), "uint16"),
        ("deepir_test/test1.png", (1, 512, 640), "uint8"),
        ("deepir_test/test2.png", (1, 512, 640), "uint8"),
    ],
)
def test_real_files_are_read(data, name, shape, dtype):
    if not (data / name).exists():
        pytest.skip(f"{data / name} is absent")
    read = read_frames(data / name)
    assert read.frames.shape == shape
    assert read.dtype == dtype


def test_real_palette_jpegs_are_refused(data):
    with pytest.raises(DataError, match="radiometry"):
        read_frames(data / "radiometric_jpg" / "flir_example_cc0.jpg")
