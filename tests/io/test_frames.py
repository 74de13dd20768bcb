import hashlib

import numpy as np
import pytest

from deepir.errors import DataError
from deepir.io import read_frames


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


def test_the_digest_is_that_of_the_file(tmp_path, burst):
    np.save(tmp_path / "a.npy", burst)
    assert (
        read_frames(tmp_path / "a.npy").sha256
        == hashlib.sha256((tmp_path / "a.npy").read_bytes()).hexdigest()
    )
