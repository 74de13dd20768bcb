import numpy as np
import pytest

from deepir.errors import DataError
from deepir.io import read_frames


def pgm(frames, largest=65535, comment=b"", plain=False):
    """Pictures one after the other."""
    height, width = frames.shape[1:]
    head = b"%s\n%s%d %d\n%d\n" % (b"P2" if plain else b"P5", comment, width, height, largest)
    if plain:
        return b"".join(
            head + b"\n".join(b" ".join(b"%d" % v for v in row) for row in f) + b"\n" for f in frames
        )
    return b"".join(head + frame.astype("u1" if largest < 256 else ">u2").tobytes() for frame in frames)


@pytest.mark.parametrize("plain", [False, True])
@pytest.mark.parametrize("comment", [b"", b"# a camera\n# of 14 bits\n"])
@pytest.mark.parametrize("largest", [255, 16383])
def test_pictures_are_read(tmp_path, burst, plain, comment, largest):
    frames = burst // (1 if largest > 255 else 64)
    (tmp_path / "a.pgm").write_bytes(pgm(frames, largest, comment, plain))
    read = read_frames(tmp_path / "a.pgm")
    assert read.dtype == ("uint8" if largest == 255 else "uint16")
    np.testing.assert_array_equal(read.frames, frames)


def test_samples_in_the_wrong_order_of_bytes_are_named(tmp_path, burst):
    frames = 8000 + burst // 64
    (tmp_path / "a.pgm").write_bytes(pgm(frames.byteswap()))
    with pytest.raises(DataError, match=r"data\.swap_bytes=true"):
        read_frames(tmp_path / "a.pgm")


@pytest.mark.parametrize("plain", [False, True])
def test_a_picture_that_is_cut_off_is_damaged(tmp_path, burst, plain):
    (tmp_path / "a.pgm").write_bytes(pgm(burst, plain=plain)[:-100])
    with pytest.raises(DataError, match=r"damaged|truncated"):
        read_frames(tmp_path / "a.pgm")
