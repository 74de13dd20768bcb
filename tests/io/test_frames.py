import hashlib

import numpy as np
import pytest

from deepir.errors import DataError
from deepir.io import read_frames


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
    assert read_frames(tmp_path / "a.npy").sha256 == hashlib.sha256((tmp_path / "a.npy").read_bytes()).hexdigest()
