import io
import struct
import zlib

import numpy as np
import pytest
import scipy.io

from deepir.errors import DataError
from deepir.io import read_frames


def test_frames_are_counted_along_matlabs_last_axis(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"burst": np.moveaxis(burst, 0, -1), "name": "flight", "rate": 30.0})
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mat").frames, burst)


def test_one_frame_is_a_matrix(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"raw": burst[0], "cal": burst[1]})
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mat").frames, burst[:1])
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mat", key="cal").frames, burst[1:2])


@pytest.mark.parametrize("dtype", ["u1", "i2", "i4", "u8", "f4", "f8"])
def test_every_numeric_class_is_read(tmp_path, burst, dtype):
    scipy.io.savemat(tmp_path / "a.mat", {"frames": (burst[0] // 128).astype(dtype)})
    read = read_frames(tmp_path / "a.mat")
    assert read.dtype == np.dtype(dtype).name
    np.testing.assert_array_equal(read.frames[0], burst[0] // 128)


def test_cells_and_structures_are_no_frames(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"camera": {"frames": burst}, "notes": np.array([burst], object)})
    with pytest.raises(DataError, match=r"no array of frames but camera \(struct\), notes \(cell\); join"):
        read_frames(tmp_path / "a.mat")
    with pytest.raises(DataError, match="no array 'camera'"):
        read_frames(tmp_path / "a.mat", key="camera")


def test_a_huge_declared_matrix_is_refused_at_once(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"frames": burst[0]})
    content = bytearray((tmp_path / "a.mat").read_bytes())
    at = content.index((20).to_bytes(4, "little") + (24).to_bytes(4, "little"))
    content[at : at + 8] = (2**31 - 1).to_bytes(4, "little") * 2
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(DataError, match="declares"):
        read_frames(tmp_path / "a.mat")


@pytest.mark.parametrize("kind", [8, 14, 99])
@pytest.mark.parametrize("compress", [False, True])
def test_values_of_no_numeric_type_are_damage(tmp_path, burst, kind, compress):
    """SciPy's reader would end the process."""
    stored = io.BytesIO()
    scipy.io.savemat(stored, {"frames": burst.transpose(1, 2, 0)})
    content = bytearray(stored.getvalue())
    content[content.find(b"frames\0\0") + 8] = kind
    if compress:
        packed = zlib.compress(bytes(content[128:]))
        content = content[:128] + struct.pack("<II", 15, len(packed)) + packed
    (tmp_path / "a.mat").write_bytes(content)
    with pytest.raises(DataError, match="which no number has"):
        read_frames(tmp_path / "a.mat")


def test_version_4_is_named(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"frame": burst[0].astype(float)}, format="4")
    with pytest.raises(DataError, match="MATLAB 4"):
        read_frames(tmp_path / "a.mat")


def test_structures_and_cells_beside_numbers_are_named_too(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"camera": {"frames": burst}, "fps": 9.0, "time": np.arange(3.0)})
    with pytest.raises(DataError, match=r"no array of frames but camera \(struct\), fps"):
        read_frames(tmp_path / "a.mat")


def test_an_axis_of_one_colour_is_dropped(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"video": np.moveaxis(burst, 0, -1)[:, :, None]})
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mat").frames, burst)


def test_frames_that_python_has_saved_are_asked_for(tmp_path, burst):
    scipy.io.savemat(tmp_path / "a.mat", {"frames": burst})
    with pytest.raises(DataError, match=r"data\.axes=wnh reads 3 frames"):
        read_frames(tmp_path / "a.mat")
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mat", axes="wnh").frames, burst)
