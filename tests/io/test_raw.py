"""Recordings without a header."""

import numpy as np
import pytest

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io import read_frames


@pytest.mark.parametrize("endian", ["little", "big"])
def test_samples_of_two_bytes_are_read_in_either_order(tmp_path, burst, endian):
    (tmp_path / "a.y16").write_bytes(
        b"head" + burst.astype({"little": "<u2", "big": ">u2"}[endian]).tobytes()
    )
    read = read_frames(tmp_path / "a.y16", raw=Raw(width=24, height=20, offset=4, endian=endian))
    assert read.dtype == "uint16"
    np.testing.assert_array_equal(read.frames, burst)


def test_up_to_eight_bits_take_one_byte(tmp_path, burst):
    burst = (burst // 64).astype(np.uint8)
    (tmp_path / "a.raw").write_bytes(burst.tobytes())
    read = read_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20, bits=8))
    assert read.dtype == "uint8"
    np.testing.assert_array_equal(read.frames, burst)


def test_flags_above_the_bits_that_count_are_cleared(tmp_path, burst):
    (tmp_path / "a.raw").write_bytes((burst | 0x8000).astype("<u2").tobytes())
    read = read_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20, bits=14), select=2)
    np.testing.assert_array_equal(read.frames, burst[:2])


def test_a_layout_that_does_not_fit_says_what_there_is(tmp_path, burst):
    (tmp_path / "a.raw").write_bytes(burst.tobytes()[:-1])
    with pytest.raises(
        DataError, match=r"after 0 bytes there are 2,879, and a frame of 20 x 24 px of 16 bits takes 960"
    ):
        read_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20))
    with pytest.raises(DataError, match="after 9999 bytes there are 0"):
        read_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20, offset=9999))
    with pytest.raises(DataError, match="no such file"):
        read_frames(tmp_path / "b.raw", raw=Raw(width=24, height=20))


@pytest.mark.parametrize("kind", ["int16", "float32", "int32", "float64"])
@pytest.mark.parametrize("endian", ["little", "big"])
def test_other_types_of_samples_are_named(tmp_path, burst, kind, endian):
    frames = (burst / 8).astype(kind) - 100
    (tmp_path / "a.raw").write_bytes(frames.astype(frames.dtype.newbyteorder(endian)).tobytes())
    read = read_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20, type=kind, endian=endian))
    assert read.dtype == kind
    np.testing.assert_array_equal(read.frames, frames)
