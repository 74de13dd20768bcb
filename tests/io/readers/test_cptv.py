import gzip
import hashlib

import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames, stream_frames


@pytest.mark.parametrize("bits", [9, 12, 16, 24])
def test_differences_of_any_width_are_exact(tmp_path, burst, bits):
    burst = burst % 60 + 3000
    recordings.cptv(tmp_path / "a.cptv", burst, bits)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.cptv").frames, burst)


def test_another_gzip_is_not_a_recording(tmp_path):
    (tmp_path / "a.cptv").write_bytes(gzip.compress(b"notes"))
    with pytest.raises(DataError, match="not a format that deepir reads"):
        read_frames(tmp_path / "a.cptv")


@pytest.mark.parametrize("width", [2**32 - 1, 2**20])
def test_a_recording_that_claims_a_huge_frame_is_refused_at_once(tmp_path, burst, width):
    recordings.cptv(tmp_path / "a.cptv", burst)
    content = gzip.decompress((tmp_path / "a.cptv").read_bytes())
    at = content.index(b"\4X") + 2
    (tmp_path / "a.cptv").write_bytes(
        gzip.compress(content[:at] + width.to_bytes(4, "little") + content[at + 4 :])
    )
    with pytest.raises(DataError, match="declares"):
        read_frames(tmp_path / "a.cptv")


def test_a_real_recording_is_what_the_projects_own_reader_finds(data):
    """SHA-256 of the frames as cptv 1.5.5 reads them."""
    frames = read_frames(data / "lepton" / "v2.cptv").frames.astype("<u2")
    assert hashlib.sha256(frames.tobytes()).hexdigest() == (
        "61a3d885b645142be914512877d5814d920fec91edfc843c3cbe37bdfda7f4d1"
    )


def test_a_recording_without_frames_is_refused(tmp_path, burst):
    recordings.cptv(tmp_path / "a.cptv", burst[:0])
    with pytest.raises(DataError, match="without frames"):
        read_frames(tmp_path / "a.cptv")
    with pytest.raises(DataError, match="without frames"):
        list(stream_frames(tmp_path / "a.cptv"))
