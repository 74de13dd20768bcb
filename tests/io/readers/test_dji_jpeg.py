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
