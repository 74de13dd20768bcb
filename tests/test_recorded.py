"""A configuration may simulate its burst."""

import numpy as np
import pytest
from PIL import Image

import deepir
from deepir.config import load
from deepir.errors import ConfigError, DataError
from deepir.runner import prepare
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture

SMALL = {"counts": True, "shape": [40, 48], "max_shift": 4, "motion": "shift"}


def burst(*settings, **simulated):
    return prepare(load("nuc", settings, {"data": {"simulate": SMALL | simulated}}))


def test_it_is_the_burst_that_the_simulator_records():
    camera = Settings(counts=True, shape=(40, 48), max_shift=4, motion="shift")
    expected = simulate(None, camera, seed=7)
    found = burst("seed=7")
    np.testing.assert_array_equal(found.frames, expected.frames)
    np.testing.assert_allclose(found.truth["scene"], expected.truth.scene, rtol=1e-6)
    np.testing.assert_array_equal(burst("data.simulate.seed=7").frames, found.frames)


def test_the_first_frames_are_those_of_the_whole_burst():
    whole, some = burst(n_frames=6), burst("data.frames=4", n_frames=6)
    np.testing.assert_array_equal(some.frames, whole.frames[:4])
    assert some.sha256 != whole.sha256


def test_truth_is_cropped_with_the_frames_and_scored():
    settings = ("data.crop=[4, 36, 8, 48]", "threads=1", "solver.max_iterations=2")
    result = deepir.run("nuc", *settings, data={"simulate": SMALL})
    assert result.scene.shape == (32, 40)
    assert result.metrics["psnr_aligned"] > 20
    assert 0 < result.metrics["radiometric_rmse"] < 1500


def test_where_a_walker_covers_the_scene_there_is_no_truth():
    assert np.isnan(burst(walker=0.5).truth["scene"]).any()


def test_without_frame_0_there_is_no_truth_to_compare_with():
    with pytest.raises(ConfigError, match="frame 0"):
        burst("data.frames=1:4")


def test_a_file_and_a_simulation_together_are_refused():
    with pytest.raises(ConfigError, match="not both"):
        burst("data.path=burst.npz")


@pytest.mark.parametrize("seed", [-1, "a", True, 0.5])
def test_a_wrong_seed_is_named(seed):
    with pytest.raises(ConfigError, match=r"data.simulate.seed"):
        burst(seed=seed)


def test_an_interrupted_run_of_a_simulated_burst_is_resumed(tmp_path):
    from deepir.storage.stored import resume

    settings = {"data": {"simulate": SMALL}, "threads": 1, "solver": {"max_iterations": 3}}

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deepir.run("nuc", callbacks=[stop], output={"dir": tmp_path / "mine"}, **settings)
    result = resume(tmp_path / "mine")
    np.testing.assert_array_equal(result.scene, deepir.run("nuc", **settings).scene)


def test_a_picture_is_stretched_to_its_range(tmp_path):
    Image.fromarray(np.linspace(50, 200, 90 * 120).reshape(90, 120).astype(np.uint8)).save(tmp_path / "a.png")
    found = load_picture(str(tmp_path / "a.png"))
    assert (found.shape, found.min(), found.max()) == ((90, 120), 0, 1)
    assert load_picture("coffee").shape == (400, 600)


def test_a_drawn_scene_is_the_same_place_whatever_the_seed():
    first, second = (burst(f"seed={seed}", scene="procedural:3", motion="shift").truth["scene"] for seed in (1, 2))
    assert np.corrcoef(first.ravel(), second.ravel())[0, 1] > 0.8  # its size follows the motion


@pytest.mark.parametrize(("name", "says"), [("moom", "did you mean 'moon'"), ("none.png", "no such file")])
def test_a_picture_that_is_not_there(name, says):
    with pytest.raises(DataError, match=says):
        load_picture(name)
