"""Recordings that do not fit into memory are read frame by frame."""

import numpy as np
import pytest
import recordings

from deepir.config.schema import Raw
from deepir.errors import DataError
from deepir.io import stream_frames


@pytest.mark.parametrize(("name", "write"), [*recordings.MANY, *recordings.ONE])
def test_every_format_gives_the_same_frames_one_by_one(tmp_path, burst, name, write):
    write(tmp_path / name, burst)
    frames = list(stream_frames(tmp_path / name))
    assert {frame.dtype.newbyteorder("=") for frame in frames} == {np.dtype(np.uint16)}
    np.testing.assert_array_equal(frames, burst[: len(frames)])
    assert len(frames) == (3 if (name, write) not in recordings.ONE else 1)


def test_a_recording_without_a_header_too(tmp_path, burst):
    (tmp_path / "a.raw").write_bytes(burst.tobytes())
    np.testing.assert_array_equal(
        list(stream_frames(tmp_path / "a.raw", raw=Raw(width=24, height=20))), burst
    )


@pytest.mark.parametrize("shape", [(3, 1, 20, 24), (3, 20, 24, 1)])
def test_axes_of_one_are_dropped(tmp_path, burst, shape):
    np.savez(tmp_path / "a.npz", frames=burst.reshape(shape))
    np.save(tmp_path / "a.npy", burst.reshape(shape))
    for name in ("a.npz", "a.npy"):
        np.testing.assert_array_equal(list(stream_frames(tmp_path / name)), burst)


@pytest.mark.parametrize("order", ["C", "F"])
def test_any_order_in_memory_is_read(tmp_path, burst, order):
    np.savez(tmp_path / "a.npz", frames=np.asarray(burst, order=order))
    np.testing.assert_array_equal(list(stream_frames(tmp_path / "a.npz")), burst)


def test_nine_gib_are_streamed(tmp_path):
    header = {"descr": "|u1", "fortran_order": False, "shape": (9 * 2**10, 2**10, 2**10)}
    with (tmp_path / "a.npy").open("wb") as file:
        np.lib.format.write_array_header_1_0(file, header)
        file.truncate(file.tell() + 9 * 2**30)  # sparse: takes no room
    assert next(stream_frames(tmp_path / "a.npy")).shape == (2**10, 2**10)


def test_a_break_is_reported_where_it_is_reached(tmp_path, burst):
    recordings.cptv(tmp_path / "a.cptv", burst)
    content = (tmp_path / "a.cptv").read_bytes()
    (tmp_path / "a.cptv").write_bytes(content[:-400])
    with pytest.raises(DataError, match="damaged or truncated"):
        list(stream_frames(tmp_path / "a.cptv"))


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("a.npy", recordings.npy),
        ("a.tif", recordings.tiff),
        ("a.seq", recordings.seq),
        ("a.h5", recordings.hdf5),
        ("a.raw", lambda path, frames: path.write_bytes(frames.tobytes())),
    ],
)
def test_a_file_that_is_cut_while_it_is_read_is_an_error(tmp_path, name, write):
    """Neither a signal, as of a memory map, nor zeros."""
    frames = np.random.default_rng(0).integers(1, 2**14, (40, 128, 160)).astype(np.uint16)
    write(tmp_path / name, frames)
    stream = stream_frames(tmp_path / name, raw=Raw(width=160, height=128) if name == "a.raw" else None)
    next(stream)
    with (tmp_path / name).open("r+b") as file:
        file.truncate(frames.nbytes // 3)
    found = []
    with pytest.raises(DataError, match=r"truncated|damaged"):
        found.extend(stream)
    assert all(np.array_equal(*each) for each in zip(found, frames[1:], strict=False))
