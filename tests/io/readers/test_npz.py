import zipfile

import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames


def test_the_only_picture_in_an_npz_needs_no_key(tmp_path, burst):
    np.savez(tmp_path / "a.npz", raw=burst, exposure=8.3, times=np.arange(3))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npz").frames, burst)


def test_frames_are_preferred_in_an_npz(tmp_path, burst):
    np.savez(tmp_path / "a.npz", frames=burst, shutter=burst[0])
    assert len(read_frames(tmp_path / "a.npz").frames) == 3
    assert len(read_frames(tmp_path / "a.npz", key="shutter").frames) == 1


def test_raw_frames_are_preferred_to_what_was_made_of_them(tmp_path, burst):
    np.savez(tmp_path / "a.npz", raw=burst, shutter=burst[0], processed=burst / 2)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npz").frames, burst)


def test_several_candidates_are_listed_with_their_shapes(tmp_path, burst):
    np.savez(tmp_path / "a.npz", day=burst, cal=burst[0])
    with pytest.raises(DataError, match=r"\(data.key\). Arrays: cal \(20, 24\), day \(3, 20, 24\)"):
        read_frames(tmp_path / "a.npz")


def test_a_misspelt_key_is_answered_with_the_nearest(tmp_path, burst):
    recordings.npz(tmp_path / "a.npz", burst)
    with pytest.raises(DataError, match="no array 'frmes'; did you mean 'frames'"):
        read_frames(tmp_path / "a.npz", key="frmes")


def test_a_zip_without_arrays_is_refused(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("readme.txt", "nothing")
    with pytest.raises(DataError, match="without NumPy arrays"):
        read_frames(tmp_path / "a.npz")


@pytest.mark.parametrize("field", [20, 24])  # of the directory: bytes packed and unpacked
def test_a_zip_bomb_is_refused_by_its_declared_size(tmp_path, field):
    with zipfile.ZipFile(tmp_path / "a.npz", "w") as archive:
        archive.writestr("frames.npy", b"x")
    content = (tmp_path / "a.npz").read_bytes()
    central = content.index(b"PK\x01\x02")
    bomb = content[: central + field] + (2**32 - 2).to_bytes(4, "little") + content[central + field + 4 :]
    (tmp_path / "a.npz").write_bytes(bomb)
    with pytest.raises(DataError, match="declares 4,294,967,294 bytes"):
        read_frames(tmp_path / "a.npz")
