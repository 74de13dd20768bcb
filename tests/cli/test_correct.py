"""`deepir correct`: a recording in, a corrected recording, maps and a picture out; and its refusals."""

import os
import signal

import numpy as np
import pytest
from skimage import data

from deepir.correct_recording import correct
from deepir.io import read_frames
from deepir.recording.keyframes import choose_keyframes
from deepir.recording.segments import estimate_segments
from deepir.storage.folder import locked_files

SIZE = (60, 80)


@pytest.fixture(scope="module")
def recording():
    """Scenes (60, 60, 80) of a camera that wanders over a picture, noise, and a pattern of columns and pixels."""
    rng = np.random.default_rng(4)
    picture = 8000 + 4.0 * data.camera()
    walk = np.cumsum(rng.integers(-2, 9, (60, 2)), 0) % 380
    scenes = np.stack([picture[y : y + SIZE[0], x : x + SIZE[1]] for y, x in walk])
    pattern = 60 * rng.standard_normal((1, SIZE[1])) + 40 * rng.standard_normal(SIZE)
    return scenes, scenes + pattern + 3 * rng.standard_normal(scenes.shape)


@pytest.fixture
def walk(folder, recording):
    """The frames in `walk.npz`, as counts."""
    frames = recording[1].round().astype(np.uint16)
    np.savez("walk.npz", frames=frames)
    return frames


@pytest.fixture(scope="module")
def segments(recording):
    return estimate_segments(choose_keyframes(iter(recording[1].round().astype(np.uint16))))


@pytest.fixture
def estimated(segments, monkeypatch):
    """The estimate is made once for all tests that ask for this."""
    monkeypatch.setattr("deepir.recording.correct.estimate_segments", lambda *_: segments)


def fixed_pattern(frames, scenes):
    """Deviation of the detail of what frames and scenes differ by in all frames."""
    difference = np.median(frames - scenes, 0)
    return np.std(np.diff(difference, axis=1))


def test_the_fixed_pattern_is_taken_off_and_maps_can_be_applied(deepir, folder, walk, recording):
    scenes, frames = recording
    assert deepir("correct", "walk.npz")[0] == 0
    ends = (".tif", "_maps.npz", ".png", ".html")
    assert outputs(folder).keys() == {f"walk_corrected{end}" for end in ends}
    corrected = read_frames("walk_corrected.tif")
    assert corrected.dtype == "uint16"
    assert fixed_pattern(corrected.frames, scenes) < 0.2 * fixed_pattern(frames, scenes)
    assert deepir("apply", "walk_corrected_maps.npz", "walk.npz", "--output", "again.tif")[0] == 0
    assert fixed_pattern(read_frames("again.tif").frames, scenes) < 0.2 * fixed_pattern(frames, scenes)


def test_a_result_is_replaced_only_on_demand(refused, folder, walk):
    (folder / "walk_corrected.tif").write_bytes(b"mine")
    refused(("correct", "walk.npz"), "--overwrite")
    assert (folder / "walk_corrected.tif").read_bytes() == b"mine"


def outputs(folder):
    return {each.name: each.read_bytes() for each in folder.glob("walk_*")}


def test_what_cannot_be_written_leaves_the_former_result(deepir, folder, walk, estimated, full_disk):
    with full_disk(100_000):  # enough for the maps
        status, _, err = deepir("correct", "walk.npz")
    assert status == 2
    assert "walk_corrected.tif: cannot be written: File too large" in err
    assert outputs(folder) == {}
    deepir("correct", "walk.npz")
    before = outputs(folder)
    with full_disk(100_000):
        assert deepir("correct", "walk.npz", "--float32", "--overwrite")[0] == 2
    assert outputs(folder) == before
    assert len(before) == 4


def test_of_an_interrupted_correction_the_maps_are_kept_unless_there_were_others(
    deepir, folder, walk, estimated, monkeypatch
):
    monkeypatch.setattr("deepir.io.output.write_frames", lambda *_: os.kill(os.getpid(), signal.SIGINT))
    status, _, err = deepir("correct", "walk.npz")
    assert status == 130
    assert "go on with: deepir apply walk_corrected_maps.npz walk.npz" in err
    assert outputs(folder).keys() == {"walk_corrected_maps.npz"}
    status, _, err = deepir("correct", "walk.npz", "--float32", "--overwrite")
    assert (status, "nothing was written" in err) == (130, True)


def test_a_part_of_the_frames_is_corrected(deepir, folder, walk, estimated):
    edged = np.pad(walk, ((0, 0), (2, 0), (0, 0)))  # as with telemetry above the picture
    np.savez("walk.npz", frames=edged)
    assert deepir("correct", "walk.npz", "data.crop=[2,62,0,80]", "--output", "part.tif")[0] == 0
    assert read_frames("part.tif").frames.shape == walk.shape
    assert np.array_equal(correct(edged, crop=[2, 62, 0, 80]).frames[5], correct(walk).frames[5])


def test_one_process_writes_a_correction(refused, folder, walk):
    with locked_files(folder / "walk_corrected.tif"):
        refused(("correct", "walk.npz"), f"another process is at work here (process {os.getpid()} on ")


def test_a_camera_at_rest_is_refused(refused, recording):
    noise = 3 * np.random.default_rng(1).standard_normal((60, *SIZE))
    np.savez("rest.npz", frames=(recording[1][0] + noise).round().astype(np.uint16))
    refused(("correct", "rest.npz"), "stands still")
