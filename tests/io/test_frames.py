"""Which frames are read: of one file, of a folder, of a glob."""

import hashlib
from pathlib import Path

import numpy as np
import pytest
import recordings
from PIL import Image

from deepir.errors import DataError
from deepir.io import read_frames
from deepir.io.readers.folder import in_order


def test_the_digest_of_a_folder_changes_with_any_of_its_files(tmp_path, burst):
    recordings.folder(tmp_path / "f", burst)
    before = read_frames(tmp_path / "f").sha256
    Image.fromarray(burst[0]).save(tmp_path / "f" / "frame9.png")
    assert read_frames(tmp_path / "f").sha256 != before


def test_folders_are_in_natural_order_and_leave_out_what_is_no_picture(tmp_path, burst):
    recordings.folder(tmp_path / "f", burst)  # frame8, frame9, frame10
    (tmp_path / "f" / "notes.txt").write_text("outside, windy")
    (tmp_path / "f" / ".hidden.png").write_bytes(b"no picture")
    (tmp_path / "f" / "Thumbs.db").touch()
    recordings.assert_read(tmp_path / "f", burst)


@pytest.mark.parametrize(
    "names",
    [
        "1732712344.9.png 1732712345.png 1732712345.125.png 1732712345.25.png 1732712345.5.png",
        "1700000000023456789.tif 1700000000123456789.tif",
        "step_-12.png step_-5.png step_0.png step_3.png",
        "v1-2.png v1-9.png v1-10.png",
        "v1.9 v1.10",
    ],
)
def test_files_are_in_the_order_of_time_stamps_and_of_steps(names):
    files = [Path(name) for name in names.split()]
    assert in_order(files[::-1]) == files


def test_globs_choose_files_from_the_current_folder_too(tmp_path, burst, monkeypatch):
    recordings.folder(tmp_path / "f", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "f" / "frame?.png").frames, burst[:2])
    monkeypatch.chdir(tmp_path)
    np.testing.assert_array_equal(read_frames("f/*.png").frames, burst)


def test_of_thermal_pictures_and_visible_ones_the_thermal_ones_are_read(tmp_path, burst, caplog):
    for number in range(3):
        recordings.flir_jpeg(tmp_path / f"IMG_{2 * number + 2:04}.jpg", burst[number : number + 1])
        Image.new("RGB", (96, 80), (200, 30, 40)).save(tmp_path / f"IMG_{2 * number + 1:04}.jpg")
    np.testing.assert_array_equal(read_frames(tmp_path).frames, burst)
    assert "3 pictures hold raw counts; 3 others are left out" in caplog.text


def test_a_visible_picture_beside_a_plain_thermal_one_says_what_to_do(tmp_path, burst):
    Image.fromarray((burst[0] // 64).astype(np.uint8)).save(tmp_path / "DJI_1_T.jpg")
    Image.new("RGB", (96, 80), (200, 30, 40)).save(tmp_path / "DJI_1_V.jpg")
    with pytest.raises(DataError, match=r"visible picture.*glob, such as '.*/\*_T\.jpg'"):
        read_frames(tmp_path)
    assert read_frames(tmp_path / "*_T.jpg").frames.shape == (1, 20, 24)


def test_the_whole_frames_of_a_recording_that_is_cut_are_read(tmp_path, burst, caplog):
    recordings.cut(recordings.seq, 100)(tmp_path / "a.seq", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq").frames, burst[:-1])
    assert "its last frame is cut off; the 2 whole ones are read" in caplog.text


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
    "select", [0, 4, -1, "4", "2:2", "3:", "0:4", "::0", "1:2:3:4", "a", "1.5", [], [3], [-4], [True], True, 1.5]
)
def test_a_selection_that_does_not_fit_says_how_many_frames_there_are(tmp_path, burst, select):
    np.save(tmp_path / "a.npy", burst)
    with pytest.raises(DataError, match="does not fit its 3 frames"):
        read_frames(tmp_path / "a.npy", select=select)


def test_the_digest_is_that_of_the_file(tmp_path, burst):
    np.save(tmp_path / "a.npy", burst)
    assert read_frames(tmp_path / "a.npy").sha256 == hashlib.sha256((tmp_path / "a.npy").read_bytes()).hexdigest()
