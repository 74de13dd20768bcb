import os
import pickle
import zipfile

import numpy as np
import pytest

from deepir.errors import DataError
from deepir.io import read_frames


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


def test_more_than_eight_gib_are_not_read_at_once(tmp_path):
    header = {"descr": "|u1", "fortran_order": False, "shape": (9, 2**15, 2**15)}
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + 9 * 2**30)  # sparse: takes no room
    with pytest.raises(DataError, match=r"9\.0 GiB of data; at most 8 GiB"):
        read_frames(tmp_path / "a.npy")


def test_an_npy_that_claims_a_huge_header_is_refused_at_once(tmp_path):
    (tmp_path / "a.npy").write_bytes(b"\x93NUMPY\2\0" + (2**32 - 1).to_bytes(4, "little") + bytes(100))
    with pytest.raises(DataError, match=r"damaged: its header claims 4,294,967,295 bytes"):
        read_frames(tmp_path / "a.npy")


def test_an_npy_of_version_two_is_read(tmp_path):
    frames = np.arange(2 * 18 * 16, dtype=np.uint16).reshape(2, 18, 16)
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array(file, frames, version=(2, 0))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.npy").frames, frames)
