"""InfiRay's pictures hold kelvin x 64."""

import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames


@pytest.fixture
def plane():
    return np.random.default_rng(0).integers(18000, 20000, (192, 256)).astype(np.uint16)


def test_temperatures_are_read(tmp_path, plane):
    recordings.infiray_jpeg(tmp_path / "a.jpg", plane[None])
    found = read_frames(tmp_path / "a.jpg")
    np.testing.assert_array_equal(found.frames[0], plane)
    np.testing.assert_allclose(found.radiometry.kelvin(plane), plane / 64)


def test_planes_that_do_not_go_with_the_picture_are_damage(tmp_path, plane):
    recordings.infiray_jpeg(tmp_path / "a.jpg", plane[None])
    content = bytearray((tmp_path / "a.jpg").read_bytes())
    frame = content.index(b"\xff\xc0") + 5  # height and width of the picture
    content[frame : frame + 4] = b"\0\x65\0\x70"
    (tmp_path / "a.jpg").write_bytes(content)
    with pytest.raises(DataError, match="of a kind that is not known"):
        read_frames(tmp_path / "a.jpg")
