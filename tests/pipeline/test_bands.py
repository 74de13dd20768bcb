"""Frames of several bands: own scenes and sensors, and one motion, that of the clearest band."""

import numpy as np
import pytest

import deepir
from deepir.calibration import read_maps
from deepir.errors import DataError
from deepir.metrics import motion_error
from deepir.simulate import Settings, simulate

CAMERA = {"n_frames": 4, "shape": (40, 48), "counts": True, "shading": 0.0, "dead_pixels": 0.0, "max_shift": 4.0}
QUICK = ("threads=1", "solver.max_iterations=12", "prior=tv")


@pytest.fixture(scope="module")
def bands():
    """Two bands of one motion, the first so faint that its noise is four times its scene: (N, 2, h, w), and truths."""
    clear = simulate(None, Settings(**CAMERA), seed=3)
    faint = simulate(None, Settings(**CAMERA | {"contrast": 10.0, "read_noise": 4.0}), seed=3)
    assert np.array_equal(faint.truth.motion, clear.truth.motion)
    return np.stack([faint.frames, clear.frames], 1), (faint.truth, clear.truth)


@pytest.fixture(scope="module")
def result(bands):
    return deepir.run("nuc", *QUICK, frames=bands[0], truth=np.stack([each.scene for each in bands[1]]))


def test_each_band_has_a_scene_and_maps_of_its_own(bands, result):
    frames, truths = bands
    for name in ("scene", "gain", "offset", "bad_pixels"):
        assert getattr(result, name).shape == (2, *frames.shape[2:])
    clear = result.offset[1] + (result.gain[1] - 1) * result.scene[1].mean()
    truth = truths[1].offset + (truths[1].gain - 1) * truths[1].scene.mean()
    assert np.corrcoef(clear.ravel(), truth.ravel())[0, 1] > 0.9
    assert [each["psnr_aligned"] > 10 for each in result.metrics["bands"]] == [True, True]


def test_the_clear_band_gives_the_faint_one_its_motion(bands, result):
    frames, truths = bands
    assert result.metrics["clearest_band"] == 1
    assert motion_error(result.motion, truths[1].motion, frames.shape[2:]) < 0.1
    assert not any("not to be trusted" in message for message in result.messages)
    with pytest.raises(DataError, match="show too little to register"):
        deepir.run("nuc", *QUICK, frames=frames[:, 0])


def test_the_clear_band_is_what_it_is_alone(bands, result):
    alone = deepir.run("nuc", *QUICK, frames=bands[0][:, 1])
    np.testing.assert_array_equal(result.scene[1], alone.scene)


def test_a_file_of_bands_runs_from_yaml_and_its_report_shows_them(bands, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    np.save("bands.npy", bands[0])
    (tmp_path / "bands.yaml").write_text("""
problem: generic
prior: tv
physics:
  warp: {motion: {type: shift, init: register}}
  sensor: {gain: {type: pixel}, offset: {type: column+row+pixel}}
data: {path: bands.npy}
threads: 1
solver: {max_iterations: 3}
""")
    result = deepir.run("bands.yaml", output={"dir": "run"})
    assert np.load("run/result.npz")["gain"].shape == (2, *bands[0].shape[2:])
    assert result.metrics["input_sha256"]
    page = (tmp_path / "run/report.html").read_text()
    assert '"name":"gain_1"' in page
    assert '"name":"scene_1"' in page
    with pytest.raises(DataError, match="maps of 2 bands; save gain"):
        read_maps(tmp_path / "run")


def test_messages_say_of_which_band_they_are(bands):
    frames = bands[0][:2].astype(float)
    frames[:, 0, :3] += 500 * np.arange(2)[:, None, None]
    messages = deepir.run("nuc", *QUICK, frames=frames).messages
    assert messages
    assert all(message.startswith(("band 0: ", "band 1: ")) for message in messages)


def test_bands_without_motion_are_solved_each_by_itself(bands):
    config = {"problem": "generic", "prior": "tv", "physics": {}}
    result = deepir.run(config, *QUICK[:2], frames=bands[0][:1])
    assert result.scene.shape == (2, *bands[0].shape[2:])
    assert np.isfinite(result.scene).all()
