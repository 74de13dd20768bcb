"""Constants of kelvin that change within a recording: each frame has its own."""

import numpy as np
import pytest
import recordings

from deepir.config.schema import Radiometry
from deepir.io import read_frames, stream_frames
from deepir.io.readers import flir
from deepir.io.radiometry import Linear, Planck

KELVIN = np.random.default_rng(0).uniform(285, 300, (20, 24)).astype(np.float32)
CHANGES = [
    {"PLANCK": {"r1": 14000.0, "o": -9000}},
    {"SCENE": {"emissivity": 0.6}},
    {"SCENE": {"reflected": 270.0, "distance": 200.0}},
]


def counted(monkeypatch, **changes):
    """FLIR's FFF of the temperatures KELVIN, as a camera with other constants and settings counts them."""
    for name, values in changes.items():
        monkeypatch.setattr(recordings, name, getattr(recordings, name) | values)
    law = flir.read_radiometry(flir.read_records(recordings.fff(np.zeros((20, 24))), "a")[0])
    content = recordings.fff(np.rint(law.counts(KELVIN)))
    monkeypatch.undo()
    return content


@pytest.mark.parametrize(
    "law", [Linear(0.04, 10.0), Planck(16556.0, 1428.0, o=-342, r2=0.0451, emissivity=0.7)]
)
def test_counts_are_the_inverse_of_kelvin(law):
    np.testing.assert_allclose(law.kelvin(law.counts(KELVIN)), KELVIN, atol=0.01)


@pytest.mark.parametrize("changes", CHANGES)
def test_each_frame_of_a_recording_has_its_own_constants(tmp_path, monkeypatch, caplog, changes):
    (tmp_path / "a.seq").write_bytes(counted(monkeypatch) + counted(monkeypatch, **changes))
    read = read_frames(tmp_path / "a.seq")
    assert "what makes kelvin of counts changes, at frame 1 first" in caplog.text
    for frames in (read.frames, np.stack(list(stream_frames(tmp_path / "a.seq")))):
        np.testing.assert_allclose(read.radiometry.kelvin(frames), np.stack([KELVIN, KELVIN]), atol=0.1)


def test_each_picture_of_a_folder_has_its_own_constants(tmp_path, monkeypatch):
    for number, changes in enumerate(({}, *CHANGES)):
        content = counted(monkeypatch, **changes)
        marked = [b"FLIR\0\1\0\0" + content]
        (tmp_path / f"{number}.jpg").write_bytes(recordings.jpeg_with(0xE1, marked, (20, 24)))
    read = read_frames(tmp_path)
    np.testing.assert_allclose(read.radiometry.kelvin(read.frames), np.stack([KELVIN] * 4), atol=0.1)


def test_what_the_user_says_of_the_scene_holds_for_all_frames(tmp_path, monkeypatch):
    """The emissivity that was set while recording does not matter then."""
    (tmp_path / "a.seq").write_bytes(counted(monkeypatch) + counted(monkeypatch, SCENE={"emissivity": 0.6}))
    asked = Radiometry(emissivity=0.9)
    plain = read_frames(tmp_path / "a.seq", radiometry=Radiometry(scale=0.01)).frames
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq", radiometry=asked).frames, plain)


def test_constants_that_stay_leave_the_counts_as_they_are(tmp_path, burst):
    recordings.seq(tmp_path / "a.seq", burst)
    assert {frame.dtype for frame in stream_frames(tmp_path / "a.seq")} == {np.dtype(np.uint16)}
