"""ENVI's headers."""

import numpy as np
import pytest

from deepir.errors import DataError
from deepir.io import read_frames, stream_frames

ORDER = {"bsq": "nhw", "bil": "hnw", "bip": "hwn"}


def envi(path, frames, interleave="bsq", kind=12, dtype="<u2", extra="", before=b""):
    """Samples, and a header beside them."""
    turned = frames.transpose(["nhw".index(each) for each in ORDER[interleave]])
    path.write_bytes(before + np.ascontiguousarray(turned).astype(dtype).tobytes())
    n, h, w = frames.shape
    path.with_suffix(".hdr").write_text(
        f"ENVI\ndescription = {{\n  a flight}}\nsamples = {w}\nlines   = {h}\nbands = {n}\n"
        f"header offset = {len(before)}\ndata type = {kind}\n"
        f"interleave = {interleave}\n{extra}"
    )


@pytest.mark.parametrize("interleave", ORDER)
@pytest.mark.parametrize("name", ["a.img", "a.raw", "a.hdr"])
def test_every_order_of_axes_is_read(tmp_path, burst, interleave, name):
    envi(tmp_path / "a.raw" if name == "a.hdr" else tmp_path / name, burst, interleave)
    np.testing.assert_array_equal(read_frames(tmp_path / name).frames, burst)
    np.testing.assert_array_equal(list(stream_frames(tmp_path / name)), burst)


@pytest.mark.parametrize(
    ("kind", "dtype"), [(1, "u1"), (2, ">i2"), (3, "<i4"), (4, ">f4"), (5, "<f8"), (12, ">u2"), (13, "<u4")]
)
def test_types_and_orders_of_bytes_are_those_of_the_header(tmp_path, burst, kind, dtype):
    frames = burst // 64
    envi(tmp_path / "a.dat", frames, "bsq", kind, dtype, f"byte order = {int('>' in dtype)}\n", b"head")
    read = read_frames(tmp_path / "a.dat")
    assert read.dtype == np.dtype(dtype).name
    np.testing.assert_array_equal(read.frames, frames)


def test_samples_of_the_ignored_value_are_lost(tmp_path, burst):
    burst[:, :2] = 7
    envi(tmp_path / "a.img", burst, extra="data ignore value = 7\n")
    assert np.isnan(read_frames(tmp_path / "a.img").frames[:, :2]).all()


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (("data type = 12", "data type = 6"), "no ENVI header of real numbers"),
        (("samples = 24", ""), "wrong or missing: 'samples'"),
        (("lines   = 20", "lines = 200"), "where a.hdr says 28,800"),
        (("bands = 3", "bands = 3\nfile compression = 1"), "without compression"),
    ],
)
def test_a_header_that_does_not_go_with_the_samples_is_refused(tmp_path, burst, change, message):
    envi(tmp_path / "a.img", burst)
    (tmp_path / "a.hdr").write_text((tmp_path / "a.hdr").read_text().replace(*change))
    with pytest.raises(DataError, match=message):
        read_frames(tmp_path / "a.img")


def test_a_header_without_samples_says_what_is_missing(tmp_path, burst):
    envi(tmp_path / "a.img", burst)
    (tmp_path / "a.img").unlink()
    with pytest.raises(DataError, match="its samples are missing"):
        read_frames(tmp_path / "a.hdr")
