"""`deepir live`: recordings, standard input and output, and mistakes."""

import io
import re
import socket
import subprocess
import sys
import time
from types import SimpleNamespace

import numpy as np
import pytest
import tifffile

from deepir.calibration import CorrectionMaps
from deepir.cli import live_frames
from deepir.cli.terminal import Interrupted
from deepir.errors import DataError
from deepir.live import recorder


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


@pytest.mark.parametrize(("crop", "left"), [([], 0), (["data.crop=[0,24,8,32]"], 8)])
def test_raw_frames_pass_from_standard_input_to_standard_output(deepir, recording, monkeypatch, crop, left):
    incoming, outgoing = io.BytesIO(recording.tobytes()), io.BytesIO()
    monkeypatch.setattr("sys.stdin", SimpleNamespace(buffer=incoming))
    monkeypatch.setattr("sys.stdout", io.TextIOWrapper(outgoing))
    sizes = "data.raw.width=32", "data.raw.height=24", *crop
    status, _, err = deepir("live", "-", *sizes, "--fast", "--output", "-")
    assert status == 0, err
    assert outgoing.getvalue() == recording[:, :, left:].tobytes()


@pytest.fixture
def shown_to_programs(monkeypatch):
    """What a virtual camera is given: its size and rate, then pictures."""
    given = []

    class Camera:
        def __init__(self, width, height, fps):
            given.append((width, height, fps))

        def send(self, picture):
            given.append(picture)

        def close(self):
            given.append("closed")

    monkeypatch.setitem(sys.modules, "pyvirtualcam", SimpleNamespace(Camera=Camera))
    return given


def test_frames_are_shown_as_a_camera_to_video_programs(deepir, recording, shown_to_programs):
    status, _, err = deepir("live", "drive.npy", "--fast", "--virtual-camera", "--rate", "9")
    assert status == 0, err
    size, *pictures, end = shown_to_programs
    assert (size, end) == ((32, 24, 9.0), "closed")
    assert len(pictures) == len(recording)
    assert (pictures[0].shape, pictures[0].dtype) == ((24, 32, 3), np.uint8)


def test_a_virtual_camera_without_a_driver_says_what_to_install(refused, recording, monkeypatch):
    def refuse(**_):
        raise RuntimeError("no device /dev/video*")

    monkeypatch.setitem(sys.modules, "pyvirtualcam", SimpleNamespace(Camera=refuse))
    refused(("live", "drive.npy", "--fast", "--virtual-camera"), "modprobe v4l2loopback")


def test_the_page_shows_the_last_frame_until_ctrl_c(deepir, recording, monkeypatch):
    pytest.importorskip("uvicorn", reason="no uvicorn: pip install 'deepir[live]'")
    shown = {}

    def keep(session, ended):
        shown.update(frame=session.newest.raw, ended=ended, tones=session.tones)
        return keep_page(session, ended)

    def interrupt(seconds):
        raise Interrupted(2)

    monkeypatch.setattr(live_frames, "time", SimpleNamespace(sleep=interrupt, monotonic=time.monotonic))
    keep_page = live_frames.keep_page
    monkeypatch.setattr(live_frames, "keep_page", keep)
    status, _, err = deepir("live", "drive.npy", "--fast", "--page", "--port", 0, "output.tones=clahe")
    assert status == 0, err
    assert re.search(r"shown at http://127\.0\.0\.1:\d+/\n", err)
    assert np.array_equal(shown["frame"], recording[-1])
    assert (shown["ended"], shown["tones"]) == ("the recording has ended", "clahe")


def test_a_port_that_is_taken_is_one_line(refused, recording):
    pytest.importorskip("uvicorn", reason="no uvicorn: pip install 'deepir[live]'")
    with socket.create_server(("127.0.0.1", 0)) as taken:
        command = ("live", "drive.npy", "--page", "--port", taken.getsockname()[1])
        refused(command, "in use; choose another with --port")


def test_only_a_page_needs_its_libraries(recording):
    code = (
        "import sys; sys.modules.update(starlette=None); from deepir.cli import main; "
        "print(main(['live', 'drive.npy', '--fast']), main(['live', 'drive.npy', '--page']))"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.stdout == "0 2\n", done.stderr
    assert "pip install 'deepir[live]'" in done.stderr.splitlines()[-1]


@pytest.mark.parametrize(
    ("end", "status", "words"), [(Interrupted(2), 0, "5 frame(s)"), (DataError("unplugged"), 2, "error: unplugged")]
)
def test_what_a_camera_gave_until_the_end_is_kept(deepir, fake, recording, end, status, words):
    fake.frames = [*recording, None, end]
    found, _, err = deepir("live", "--camera", "fake", "--fast", "--output", "out.tif")
    assert (found, words in err, "switch it off" in err) == (status, True, True), err
    assert np.array_equal(tifffile.imread("out.tif"), recording)


def test_the_maps_of_a_camera_are_kept_for_the_next_time(deepir, fake, recording, monkeypatch, tmp_path):
    fake.frames, fake.identity = [*recording, Interrupted(2)], "fake / 4711"
    size = recording.shape[1:]
    maps = CorrectionMaps(np.ones(size), np.zeros(size), np.zeros(size, bool))
    monkeypatch.setattr(recorder, "user_data_path", lambda name: tmp_path / name)
    command = ("live", "--camera", "fake", "--fast")
    assert "begins with" not in deepir(*command)[2]
    recorder.KeptMaps(fake.identity).save(maps)
    assert (tmp_path / "deepir" / "cameras" / "fake_4711.npz").exists()
    assert "begins with the camera's maps of 2" in deepir(*command)[2]
    wider = CorrectionMaps(*(np.pad(each, 1) for each in (maps.gain, maps.offset, maps.bad_pixels)))
    recorder.KeptMaps(fake.identity).save(wider)  # of another mode
    assert "begins with" not in deepir(*command)[2]
