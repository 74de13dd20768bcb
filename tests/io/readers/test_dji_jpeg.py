import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames


@pytest.fixture
def frame():
    return np.random.default_rng(1).integers(0, 2**14, (1, 120, 160), dtype=np.uint16)


def test_the_raw_plane_is_read_and_not_the_picture(tmp_path, frame):
    recordings.dji_jpeg(tmp_path / "a.jpg", frame)
    read = read_frames(tmp_path / "a.jpg")
    assert read.dtype == "uint16"
    np.testing.assert_array_equal(read.frames, frame)


def test_a_picture_of_another_size_does_not_matter(tmp_path):
    plane = np.random.default_rng(1).integers(0, 2**14, (512, 640), dtype=np.uint16)
    content = plane.astype("<u2").tobytes()
    parts = [content[at : at + 60_000] for at in range(0, len(content), 60_000)]
    (tmp_path / "a.jpg").write_bytes(recordings.jpeg_with(0xE3, parts, (48, 64)))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.jpg").frames[0], plane)


def test_a_plane_that_fits_no_detector_is_refused(tmp_path, frame):
    (tmp_path / "a.jpg").write_bytes(recordings.jpeg_with(0xE3, [bytes(50_000)], (120, 160)))
    with pytest.raises(DataError, match="50,000 bytes of raw plane fit no detector"):
        read_frames(tmp_path / "a.jpg")


@pytest.mark.parametrize("marker", [0xE2, 0xE4, 0xE5, 0xE8, 0xEF])
def test_raw_data_of_an_unknown_kind_are_no_reason_to_read_the_preview(tmp_path, marker):
    """DJI's XT S keeps them in other segments."""
    (tmp_path / "a.jpg").write_bytes(recordings.jpeg_with(marker, [bytes(60_000)] * 10, (120, 160)))
    with pytest.raises(DataError, match=rf"not known \(APP{marker - 0xE0}: 600,000 bytes\).*only a preview"):
        read_frames(tmp_path / "a.jpg")


def test_raw_data_behind_the_picture_are_named_and_a_second_picture_is_none(tmp_path):
    picture = recordings.jpeg_with(0xE1, [b"Exif\0\0"], (120, 160))
    (tmp_path / "a.jpg").write_bytes(picture + bytes(40_000))
    with pytest.raises(DataError, match="after the picture: 40,000 bytes"):
        read_frames(tmp_path / "a.jpg")
    (tmp_path / "a.jpg").write_bytes(picture + picture + bytes(40_000))
    assert read_frames(tmp_path / "a.jpg").dtype == "uint8"
