"""Runs from Python."""

import json

import numpy as np
import pytest
import torch

import deepir
from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate

QUICK = {"threads": 1, "solver": {"max_iterations": 3}}


@pytest.fixture(scope="module")
def frames():
    camera = Settings(n_frames=3, shape=(40, 48), counts=True, max_shift=4.0, motion="shift", dead_pixels=0.0)
    return simulate(None, camera, seed=3).frames


def test_a_run_in_memory_writes_nothing(frames, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = deepir.run("nuc", frames=frames, prior="tv", **QUICK)
    assert result.scene.shape == (40, 48)
    assert list(tmp_path.iterdir()) == []


def test_the_same_run_gives_the_same_scene(frames):
    first, second = (deepir.run("nuc", frames=frames, **QUICK).scene for _ in range(2))
    assert np.array_equal(first, second)


def test_the_number_of_threads_is_the_callers_again(frames):
    before = torch.get_num_threads()
    deepir.run("nuc", frames=frames, **QUICK)
    assert torch.get_num_threads() == before


def test_callbacks_see_every_iteration(frames):
    seen = []
    deepir.run("nuc", frames=frames, callbacks=[seen.append], **QUICK)
    assert seen
    assert all(each.iteration <= 3 for each in seen)
    assert seen[-1].done <= 1


def test_overrides_and_options_go_together(frames):
    result = deepir.run("nuc", "solver.max_iterations=1", frames=frames, method="average", **QUICK)
    assert result.metrics["method"] == "average"
    assert np.all(result.gain == 1)


def test_a_folder_is_written_when_it_is_named(frames, tmp_path):
    result = deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, **QUICK)
    assert np.array_equal(np.load(tmp_path / "mine/result.npz")["scene"], result.scene)
    assert json.loads((tmp_path / "mine/metrics.json").read_text())["stop_reason"]
    with pytest.raises(ConfigError, match="holds another run"):
        deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, **QUICK)
    deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, overwrite=True, **QUICK)


def test_frames_from_memory_cannot_be_resumed(frames, tmp_path):
    from deepir.stored import resume

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, callbacks=[stop], **QUICK)
    with pytest.raises(ConfigError, match="came from memory"):
        resume(tmp_path / "mine")


def test_truth_of_another_size_is_an_error(frames, tmp_path):
    np.save(tmp_path / "truth.npy", np.zeros((10, 12)))
    with pytest.raises(DataError, match="10 x 12 px"):
        deepir.run("nuc", frames=frames, data={"truth": tmp_path / "truth.npy"}, **QUICK)


@pytest.mark.parametrize("wrong", [np.zeros((2, 3, 40, 48)), np.zeros(5), np.array(["a"])])
def test_frames_of_another_shape_are_an_error(wrong):
    with pytest.raises(DataError, match="frames"):
        deepir.run("nuc", frames=wrong)


def test_a_misspelt_option_is_an_error(frames):
    with pytest.raises(ConfigError, match="did you mean 'prior'"):
        deepir.run("nuc", frames=frames, piror="tv")
