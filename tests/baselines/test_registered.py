"""What holds for every method beside `joint`, a new one too: it is found in the registry."""

import functools
import inspect

import numpy as np
import pytest

import deepir
from deepir import registry
from deepir.baselines.rival import estimate_offset, rival
from deepir.errors import ConfigError
from deepir.registry import components
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture

#: The part of the camera's burst that a problem is run on; a finer scene of the whole takes a minute.
PARTS = {"nuc": np.s_[:, :, :], "sr": np.s_[:4, 8:56, 10:70]}
RIVALS = [name for name, each in components("method").items() if each.__module__.startswith("deepir.baselines")]
#: Options without which a method does not run: arrays that are saved, and named.
GIVEN = {"flat_field": {"shutter": lambda sim, part: 300 + sim.truth.offset[None][part]}}


@pytest.fixture(scope="module")
def camera():
    """Eight frames in counts, 64 x 80 px."""
    settings = Settings(n_frames=8, shape=(64, 80), counts=True, max_shift=5.0)
    return simulate(load_picture("camera"), settings, seed=4)


@pytest.fixture(scope="module")
def run(camera, tmp_path_factory):
    """The result of a method on the camera's burst."""

    @functools.cache
    def run(name, problem="nuc"):
        folder, options = tmp_path_factory.mktemp(name), {"type": name}
        for key, make in GIVEN.get(name, {}).items():
            np.save(folder / f"{key}.npy", make(camera, PARTS[problem]))
            options[key] = str(folder / f"{key}.npy")
        return deepir.run(problem, frames=camera.frames[PARTS[problem]], method=options)

    return run


@pytest.mark.parametrize("name", RIVALS)
def test_the_result_is_whole_and_in_the_gauge_and_keeps_the_level(run, camera, name):
    result = run(name)
    assert result.scene.shape == camera.truth.scene.shape
    assert result.scene.dtype == result.gain.dtype == result.offset.dtype == np.float32
    assert all(np.isfinite(each).all() for each in (result.scene, result.gain, result.offset))
    assert result.motion.shape == (8, 3, 3)
    assert np.array_equal(result.motion[0], np.eye(3))
    good = ~result.bad_pixels
    assert result.gain[good].mean() == pytest.approx(1, abs=1e-5)
    assert result.offset[good].mean() == pytest.approx(0, abs=0.01)
    assert result.level.mean() == pytest.approx(0, abs=0.01)
    assert abs(result.scene.mean() - camera.truth.scene.mean()) < 0.05 * camera.settings.contrast


@pytest.mark.parametrize("name", RIVALS)
def test_it_runs_on_a_scene_finer_than_the_detector(run, name):
    assert run(name, "sr").scene.shape == (4 * 48, 4 * 60)


@pytest.mark.parametrize("name", RIVALS)
def test_it_says_what_it_is_and_where_it_is_from(name):
    method = components("method")[name]
    assert name in ("average", "bicubic") or "(19" in method.__doc__ or "(20" in method.__doc__
    assert list(inspect.signature(method).parameters)[:2] == ["burst", "config"]


def test_a_function_of_arrays_becomes_a_method_with_its_options(camera, monkeypatch):
    monkeypatch.setattr(registry, "_components", {k: dict(v) for k, v in registry._components.items()})

    @rival("level", estimate_offset)
    def level(frames: np.ndarray, *, share: float = 1.0) -> np.ndarray:
        """A share of the mean frame."""
        return share * frames.mean(0)

    result = deepir.run("nuc", frames=camera.frames, method={"type": "level", "share": 0.5})
    assert (result.offset - level(camera.frames, share=0.5)).std() < 0.01
    with pytest.raises(ConfigError, match="method 'level': no option 'shar'; did you mean 'share'"):
        deepir.run("nuc", frames=camera.frames, method={"type": "level", "shar": 0.5})
