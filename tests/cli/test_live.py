"""`deepir live`: recordings, standard input and output, and mistakes."""

import io
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from deepir import registry
from deepir.cameras.camera import Camera
from deepir.cli.signals import Interrupted
from deepir.errors import DataError


@pytest.fixture
def recording(folder):
    """Frames (5, 24, 32) in `drive.npy`."""
    frames = np.random.default_rng(0).integers(1000, 2000, (5, 24, 32)).astype(np.uint16)
    np.save("drive.npy", frames)
    return frames


def test_frames_are_written_in_their_own_type(deepir, recording):
    status, _, err = deepir("live", "drive.npy", "--fast", "--output", "out.tif")
    assert status == 0, err
    assert "5 frame(s); waiting for motion" in err
    assert np.array_equal(tifffile.imread("out.tif"), recording)
    status, _, err = deepir("live", "drive.npy", "--fast", "--output", "out.tif")
    assert (status, "--overwrite" in err) == (2, True)


def test_raw_frames_pass_from_standard_input_to_standard_output(deepir, recording, monkeypatch):
    incoming, outgoing = io.BytesIO(recording.tobytes()), io.BytesIO()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=incoming))
    monkeypatch.setattr("deepir.cli.commands.live.standard_output", lambda: outgoing)
    status, _, err = deepir("live", "-", "data.raw.width=32", "data.raw.height=24", "--fast", "--output", "-")
    assert status == 0, err
    assert outgoing.getvalue() == recording.tobytes()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ((), "give a recording, or a camera"),
        (("drive.npy", "--camera", "v4l2"), "give a recording, or a camera"),
        (("-",), "data.raw.width"),
        (("dirve.npy",), "no such file"),
        (("drive.npy", "solver.max_iterations=3"), "only settings of"),
        (("drive.npy", "--maps", "nowhere.npz"), "nowhere.npz"),
        (("drive.npy", "--output", "out.avi"), "written as .tif"),
        (("--camera", "boson5"), "boson5"),
    ],
)
def test_mistakes_are_one_line(deepir, recording, arguments, words):
    status, out, err = deepir("live", "--fast", *arguments)
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("end", "status", "words"),
    [(Interrupted(2), 0, "5 frame(s)"), (DataError("unplugged"), 2, "error: unplugged")],
)
def test_what_a_camera_gave_until_the_end_is_kept(deepir, recording, monkeypatch, end, status, words):
    class Fake(Camera):
        """A camera that is made up."""

        correction = "switch it off"

        def __init__(self):
            self.coming = iter([*recording, None, end])

        def read(self):
            frame = next(self.coming)
            if isinstance(frame, BaseException):
                raise frame
            return frame

    monkeypatch.setitem(registry._components["camera"], "fake", Fake)
    found, _, err = deepir("live", "--camera", "fake", "--fast", "--output", "out.tif")
    assert (found, words in err, "switch it off" in err) == (status, True, True), err
    assert np.array_equal(tifffile.imread("out.tif"), recording)
