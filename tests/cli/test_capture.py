"""`deepir capture` with a camera that is made up: what it keeps, what it says, and how it ends."""

import itertools
import sys

import numpy as np
import pytest

from deepir.cameras import camera as capturing
from deepir.cli.terminal import Interrupted
from deepir.io import read_frames


@pytest.fixture
def take(deepir):
    """`deepir capture taken.npz --camera fake`, as fast as the camera goes."""

    def run(*arguments):
        return deepir("capture", "taken.npz", "--camera", "fake", "--every", 0, *arguments)

    return run


def test_what_the_camera_gave_is_a_burst_that_a_run_reads(fake, take, nuc, folder, burst):
    status, out, err = take("--frames", 3)
    assert status == 0, err
    read = read_frames(folder / "taken.npz")
    assert read.dtype == "uint16"
    np.testing.assert_array_equal(read.frames, burst.frames)
    assert "taken.npz: 3 frame(s) of 40 x 48 px, uint16" in out
    assert "deepir: switch it off" in err
    assert fake.closed == fake.opened == 1
    assert nuc("data.path=taken.npz")[0] == 0


def test_it_says_how_far_the_camera_has_moved(fake, take):
    _, _, err = take("--frames", 3)
    first, second, third = err.splitlines()[1:]
    assert first == "deepir: frame 1 of 3; move the camera, in a small circle"
    assert second.startswith("deepir: frame 2 of 3; ")
    assert "px along x" in second
    assert third == "deepir: frame 3 of 3; that was the last"


def test_the_reach_is_that_of_the_motion(burst):
    at = burst.truth.motion[:, :2, 2]
    np.testing.assert_allclose(capturing.motion_span(list(burst.frames)), np.ptp(at, axis=0), atol=0.2)


@pytest.mark.parametrize(
    ("span", "said"),
    [
        ((0.4, 1.0), "in a small circle"),
        ((0.4, 7.0), "sideways"),
        ((7.0, 0.4), "up and down"),
        ((7.0, 5.0), "well done"),
        (None, "another place"),
    ],
)
def test_the_advice_is_what_is_missing(span, said):
    assert said in capturing.advice(span)


def test_a_frame_that_comes_twice_is_taken_once(fake, take, folder, burst):
    fake.frames = [None, *np.repeat(burst.frames, 3, axis=0)]
    take("--frames", 3)
    np.testing.assert_array_equal(read_frames(folder / "taken.npz").frames, burst.frames)


def test_frames_lie_apart_in_time(fake, take, folder, burst):
    rng = np.random.default_rng(0)
    frame = burst.frames[0]
    fake.frames = (frame + rng.integers(0, 9, frame.shape, dtype=np.uint16) for _ in itertools.count())
    assert take("--frames", 3, "--every", 0.02)[0] == 0
    with np.load(folder / "taken.npz") as stored:
        assert (np.diff(stored["time"]) >= 0.02).all()


def test_a_shutter_in_the_midst_is_reported(fake, take, monkeypatch, burst):
    monkeypatch.setattr(capturing, "FREEZE_TIME", 0.02)
    monkeypatch.setattr(capturing, "FRAME_TIMEOUT", 60.0)
    a, b, c = burst.frames
    fake.frames = [a, *[b] * 20, c]
    status, _, err = take("--frames", 3)
    assert status == 0
    assert "the picture stood still for" in err
    assert "Switch the automatic correction off" in err


@pytest.mark.parametrize(
    ("count", "then", "status", "says"),
    [
        (1, [], 2, ["has not changed for", "shutter"]),
        (0, [None], 2, ["has sent nothing"]),
        (2, [Interrupted(2)], 130, ["deepir: interrupted; nothing was written\n"]),
    ],
)
def test_a_camera_that_fails_and_ctrl_c_write_nothing_and_give_the_camera_back(
    fake, take, folder, count, then, status, says
):
    fake.frames = [*fake.frames[:count], *then]
    found, _, err = take("--frames", 3)
    assert found == status
    for each in says:
        assert each in err
    assert not (folder / "taken.npz").exists()
    assert fake.closed == 1


@pytest.mark.parametrize(
    ("camera", "library", "extra"), [("v4l2", "av", "camera"), ("boson", "flirpy.camera.boson", "boson")]
)
def test_without_the_library_the_extra_is_named(refused, monkeypatch, camera, library, extra):
    monkeypatch.setitem(sys.modules, library, None)
    refused(("capture", "taken.npz", "--camera", camera), f"pip install 'deepir[{extra}]'")
