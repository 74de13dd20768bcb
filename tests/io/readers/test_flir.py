"""FLIR's records, in pictures and in recordings."""

import struct
from pathlib import Path

import imagecodecs
import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames
from deepir.io.readers import flir


@pytest.mark.parametrize("order", ["<", ">"])
def test_both_byte_orders_are_read(tmp_path, burst, order):
    (tmp_path / "a.seq").write_bytes(b"".join(recordings.fff(frame, order=order) for frame in burst))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq").frames, burst)


def test_what_lies_between_frames_is_skipped(tmp_path, burst):
    (tmp_path / "a.seq").write_bytes(b"padding 123".join(recordings.fff(frame) for frame in burst))
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq").frames, burst)


def test_counts_that_look_like_flirs_mark_are_counts(tmp_path, burst):
    burst[1, 4, 6:8] = np.frombuffer(b"FFF\0", "<u2")
    recordings.seq(tmp_path / "a.seq", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq").frames, burst)


def test_a_frame_of_another_size_is_an_error(tmp_path, burst):
    (tmp_path / "a.seq").write_bytes(recordings.fff(burst[0]) + recordings.fff(burst[1, :18]))
    with pytest.raises(DataError, match=r"frames differ in size: \(20, 24\) and \(18, 24\)"):
        read_frames(tmp_path / "a.seq")


def test_a_picture_of_another_size_than_its_record_is_damaged(tmp_path, burst):
    packed = imagecodecs.jpegls_encode(burst[0, :18])
    (tmp_path / "a.csq").write_bytes(recordings.fff(burst[0], packed))
    with pytest.raises(DataError, match=r"its raw plane is \(18, 24\), its record says \(20, 24\)"):
        read_frames(tmp_path / "a.csq")


def test_a_picture_that_claims_a_huge_size_is_refused_at_once(tmp_path, burst):
    packed = bytearray(imagecodecs.jpegls_encode(burst[0]))
    at = packed.index(b"\xff\xf7") + 5
    packed[at : at + 4] = b"\xff\xff\xff\xff"
    (tmp_path / "a.csq").write_bytes(recordings.fff(burst[0], bytes(packed)))
    with pytest.raises(DataError, match="declares 8,589,672,450 bytes"):
        read_frames(tmp_path / "a.csq")


def test_a_missing_segment_of_a_picture_is_damage(tmp_path, burst):
    recordings.flir_jpeg(tmp_path / "a.jpg", burst)
    content = (tmp_path / "a.jpg").read_bytes()
    second = content.index(b"FLIR\0\1\1")
    (tmp_path / "a.jpg").write_bytes(content[: second - 4] + content[second + 404 + 4 :])
    with pytest.raises(DataError, match="of FLIR's 5 segments it has 4"):
        read_frames(tmp_path / "a.jpg")


def test_a_plain_jpeg_stays_a_plain_jpeg(tmp_path):
    (tmp_path / "a.jpg").write_bytes(recordings.jpeg_with(0xE1, [b"Exif\0\0"], (20, 24)))
    assert read_frames(tmp_path / "a.jpg").dtype == "uint8"


@pytest.mark.parametrize(
    ("name", "mean"),
    [("aqua_tower", 12614.372716049384), ("example", 13107.4361328125), ("moving_car", 15031.2069140625)],
)
def test_real_pictures_hold_the_counts_that_flyr_finds(data, name, mean):
    """Means of the raw planes as flyr 5.1.0 reads them."""
    read = read_frames(data / "radiometric_jpg" / f"flir_{name}_cc0.jpg")
    assert read.frames.mean(dtype=np.float64) == pytest.approx(mean, rel=1e-9)


def test_the_whole_frames_of_a_recording_that_is_cut_are_read(tmp_path, burst, caplog):
    content = b"".join(recordings.fff(frame) for frame in burst)
    (tmp_path / "a.seq").write_bytes(content[:-100])
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq").frames, burst[:-1])
    assert "its last frame is cut off; the 2 whole ones are read" in caplog.text


def test_a_break_in_the_midst_of_a_recording_is_damage(tmp_path, burst):
    parts = [recordings.fff(frame) for frame in burst]
    (tmp_path / "a.seq").write_bytes(parts[0] + parts[1][:80] + parts[2])
    with pytest.raises(DataError):
        read_frames(tmp_path / "a.seq")


@pytest.mark.parametrize("swapped", [False, True])
def test_pngs_are_read_in_either_order_of_bytes(swapped):
    plane = np.random.default_rng(0).integers(12000, 13000, (20, 24)).astype(np.uint16)
    stored = plane.byteswap() if swapped else plane
    packed = imagecodecs.png_encode(stored)
    record = struct.pack("<HHH", 2, 24, 20) + bytes(26) + packed
    np.testing.assert_array_equal(flir.read_raw_plane({flir.RAW_RECORD: record}, Path("a.jpg")), plane)


def test_the_older_kind_of_seq_is_named(tmp_path, burst):
    (tmp_path / "a.seq").write_bytes(b"AFF\0" + recordings.fff(burst[0])[4:])
    with pytest.raises(DataError, match=r"older SEQ \(AFF\), which is not read; export"):
        read_frames(tmp_path / "a.seq")
