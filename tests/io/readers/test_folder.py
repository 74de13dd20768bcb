import numpy as np
import pytest
import recordings
from PIL import Image

from deepir.errors import DataError
from deepir.io import read_frames


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
    np.testing.assert_array_equal(read_frames(tmp_path / "f").frames, burst)


def test_globs_choose_files(tmp_path, burst):
    recordings.folder(tmp_path / "f", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "f" / "frame?.png").frames, burst[:2])


def test_globs_work_from_the_current_folder(tmp_path, burst, monkeypatch):
    recordings.folder(tmp_path / "f", burst)
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
    recordings.folder(tmp_path / "f", burst)
    (tmp_path / "f" / "frame9.png").write_bytes(b"")
    with pytest.raises(DataError, match=r"frame9\.png: the file is empty"):
        read_frames(tmp_path / "f")


def test_folders_without_pictures_and_globs_without_matches_say_so(tmp_path):
    (tmp_path / "notes.txt").write_text("nothing")
    with pytest.raises(DataError, match=r"no pictures in this folder \(\.avi"):
        read_frames(tmp_path)
    with pytest.raises(DataError, match="no file matches"):
        read_frames(tmp_path / "*.png")


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


def test_files_of_several_formats_are_named(tmp_path, burst):
    recordings.tiff(tmp_path / "a.tif", burst)
    Image.new("RGB", (24, 20), (200, 30, 40)).save(tmp_path / "a.jpg")
    with pytest.raises(DataError, match=r"several formats lie side by side \(\.jpg, \.tif\).*/\*\.tif'"):
        read_frames(tmp_path)
