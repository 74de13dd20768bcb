"""Runs from Python."""

import json
import re
from contextlib import chdir

import numpy as np
import pytest
import torch

import deepir
from deepir.burst import load as load_burst
from deepir.config import Data
from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate

QUICK = {"threads": 1, "solver": {"max_iterations": 3}}


@pytest.fixture(scope="module")
def frames(burst):
    return burst.frames


@pytest.fixture(scope="module")
def seen():
    """The progress that a callback of `result` saw."""
    return []


@pytest.fixture(scope="module")
def here(tmp_path_factory):
    """The working folder of `result`."""
    return tmp_path_factory.mktemp("here")


@pytest.fixture(scope="module")
def result(frames, seen, here):
    """A run in memory."""
    with chdir(here):
        return deepir.run("nuc", frames=frames, callbacks=[seen.append], **QUICK)


def test_a_run_in_memory_writes_nothing_and_restores_the_number_of_threads(result, here):
    assert result.scene.shape == (40, 48)
    assert list(here.iterdir()) == []
    assert torch.get_num_threads() == 1  # of the tests


def test_callbacks_see_every_iteration(result, seen):
    assert seen
    assert all(each.iteration <= 3 for each in seen)
    assert seen[-1].done <= 1


def test_a_frame_that_shows_nothing_is_left_out_and_reported(frames, result):
    damaged, lost = (np.insert(frames.astype(np.float32), 1, value, axis=0) for value in (7, np.nan))
    said = "frame 1 is left out: it is {}. Frames are counted without it"
    found = deepir.run("nuc", frames=damaged, **QUICK)
    assert found.messages[0] == said.format("7 everywhere (a shutter, or lost)")
    assert np.array_equal(found.scene, result.scene)  # repeatable, too
    burst = load_burst(Data(), frames=lost)
    assert burst.messages == (said.format("100% NaN or infinite"),)
    assert np.array_equal(burst.frames, frames)


def test_that_results_are_relative_to_another_frame_is_reported(frames):
    damaged = np.insert(frames.astype(np.float32), 0, np.nan, axis=0)
    messages = deepir.run("nuc", frames=damaged, **QUICK).messages
    assert any("relative to what was frame 1" in message for message in messages)


@pytest.mark.parametrize("scenes", [2, 4])
def test_the_truth_of_a_lost_frame_is_dropped_with_it(frames, tmp_path, scenes):
    damaged = np.insert(frames.astype(np.float32), 1, np.nan, axis=0)
    scene = np.arange(scenes)[:, None, None] * np.ones((40, 48))
    np.savez(tmp_path / "truth.npz", scene=scene, level=np.arange(4.0))
    truth = load_burst(Data(truth=str(tmp_path / "truth.npz")), frames=damaged).truth
    assert truth["level"].tolist() == [0, 2, 3]
    assert truth["scene"][:, 0, 0].tolist() == ([0, 2, 3] if scenes == 4 else [0, 1])


def test_too_few_frames_that_show_something_are_refused(frames):
    damaged = frames.astype(np.float32)
    damaged[1:] = 0
    with pytest.raises(DataError, match="frame 1 is 0 everywhere"):
        deepir.run("nuc", frames=damaged, **QUICK)


def test_a_lost_frame_is_refused_where_frames_follow_each_other_in_time(frames):
    damaged = np.insert(frames.astype(np.float32), 1, np.nan, axis=0)
    with pytest.raises(DataError, match="frame 1 is 100% NaN"):
        deepir.run("deblur_lag", frames=damaged, **QUICK)


def test_overrides_and_options_go_together(frames):
    result = deepir.run("nuc", "solver.max_iterations=1", frames=frames, method="average", **QUICK)
    assert result.metrics["method"] == "average"
    assert np.all(result.gain == 1)


def test_a_folder_is_written_when_it_is_named(frames, tmp_path):
    given = {"frames": frames, "method": "average", "output": {"dir": tmp_path / "mine"}}
    result = deepir.run("nuc", **given)
    assert np.array_equal(np.load(tmp_path / "mine/result.npz")["scene"], result.scene)
    assert json.loads((tmp_path / "mine/metrics.json").read_text())["stop_reason"]
    with pytest.raises(ConfigError, match="already contains a run"):
        deepir.run("nuc", **given)
    deepir.run("nuc", overwrite=True, **given)


def test_frames_from_memory_cannot_be_resumed(frames, tmp_path):
    from deepir.storage.stored import resume

    def stop(progress):
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, callbacks=[stop], **QUICK)
    with pytest.raises(ConfigError, match="came from memory"):
        resume(tmp_path / "mine")


@pytest.mark.parametrize("kind", [torch.bfloat16, torch.float64, torch.float32])
def test_frames_may_be_a_tensor_of_any_kind(frames, kind):
    tensor = torch.from_numpy(frames.astype(np.float32)).to(kind).requires_grad_()
    assert np.array_equal(load_burst(Data(), frames=tensor).frames, tensor.detach().float().numpy())


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        (np.zeros((2, 3, 40, 48)), "frames"),
        (np.zeros(5), "frames"),
        (np.array(["a"]), "frames"),
        ([np.zeros((40, 48)), np.zeros((20, 48))], "frames: no array"),
        ([np.zeros((40, 48)), None], "frames: no array"),
        (torch.empty(3, 40, 48, device="meta"), "frames: no array"),
    ],
    ids=str,
)
def test_arrays_that_are_no_frames_are_refused(wrong, says):
    with pytest.raises(DataError, match=says):
        deepir.run("nuc", frames=wrong)


@pytest.mark.parametrize(
    ("config", "settings", "options", "says"),
    [
        (None, (), {}, "is needed"),
        (3, (), {}, "is needed"),
        ("nuc", (3,), {}, "is text"),
        ("nuc", ({"seed": 3},), {}, "is text"),
        ("nuc", (), {"data": {"truth": np.zeros((40, 48))}}, "name of its file"),
        ("nuc", (), {"piror": "tv"}, "did you mean 'prior'"),
        ("nuc", ("physics.warp=null",), {}, "needs a stage 'warp'; or take problem=generic"),
        ("nuc", ("physics.sensor=null",), {}, "needs a stage 'sensor'; or take problem=generic"),
        # A blur after the sensor, which would then be larger than the frames.
        ("nuc", (), {"physics": {"blur": {"psf": "gaussian"}}}, "that change the size go before 'sensor'"),
        ("nuc", (), {"prior": "gaussian"}, r"'gaussian' does not fit: \(1, 1, \d+, \d+\) is wanted$"),
        ("nuc", ("physics.sensor.gain=0",), {}, "a gain has a positive mean"),
        ("nuc", ("physics.warp.motion=3",), {}, "the first frame's motion is the identity"),
    ],
)
def test_a_configuration_that_makes_no_sense_is_an_error(frames, config, settings, options, says):
    with pytest.raises(ConfigError, match=says):
        deepir.run(config, *settings, frames=frames, **options, **QUICK)


def test_frames_from_memory_are_selected_too(frames):
    result = deepir.run("nuc", "data.frames=[0, 2]", frames=frames, method="average")
    assert len(result.frames_used) == 2
    with pytest.raises(DataError, match="does not fit its 3 frames"):
        deepir.run("nuc", "data.frames=7", frames=frames, **QUICK)


def camera(**more):
    settings = {"n_frames": 4, "shape": (48, 56), "counts": True, "max_shift": 6.0, "motion": "shift"}
    return simulate(None, Settings(**settings | more), seed=1)


def test_a_burst_that_moves_along_one_axis_only_is_warned_of():
    messages = deepir.run("nuc", frames=camera(jitter="x").frames, **QUICK).messages
    assert re.match(r"the frames move by only 0\.\d px along y: ", messages[0])


def test_a_drift_of_the_level_is_warned_of_and_found():
    sim = camera(level_drift=0.05)
    ignored = deepir.run("nuc", "physics.sensor.level=0", frames=sim.frames, threads=1)
    assert any("physics.sensor.level=drift" in each for each in ignored.messages)
    found = deepir.run("nuc", frames=sim.frames, threads=1)
    (message,) = found.messages
    assert message.startswith("the level of whole frames drifts")
    assert np.abs(found.level - sim.truth.level).max() < 0.1 * np.ptp(sim.truth.level)


@pytest.mark.parametrize("level", ["drift", "pixels", "0.0"])
def test_a_steady_level_is_not_warned_of(level):
    setting = f"physics.sensor.level={level}"
    # Of four frames levels without a prior take up half a count: a slope of the scene.
    assert deepir.run("nuc", setting, frames=camera(n_frames=6).frames, threads=1).messages == []


def test_data_rounded_more_coarsely_than_they_are_noisy_are_solved():
    # In float32 a range of one around 1e6 has steps of 0.06.
    frames = camera(counts=False).frames.astype(float) + 1e6
    assert np.isfinite(deepir.run("nuc", frames=frames, **QUICK).scene).all()


def test_masked_samples_of_frames_from_memory_are_left_out(frames):
    masked = np.ma.array(frames, mask=np.random.default_rng(0).random(frames.shape) < 0.01)
    spoilt = np.ma.array(np.where(masked.mask, 0, frames), mask=masked.mask)
    one, other = (load_burst(Data(), frames=each) for each in (masked, spoilt))
    assert np.array_equal(one.frames, other.frames)
    assert np.array_equal(one.valid, other.valid)
    assert np.array_equal(one.valid, ~masked.mask)


def test_a_motion_is_registered_unless_it_says_otherwise(frames):
    physics = {"warp": {"motion": "shift"}, "sensor": {"gain": "pixel", "offset": "pixel"}}
    config = {"problem": "nuc", "physics": physics, **QUICK}
    named = deepir.run(config, frames=frames)
    said = deepir.run(config, "physics.warp.motion={type: shift, init: register}", frames=frames)
    np.testing.assert_array_equal(named.motion, said.motion)


@pytest.mark.parametrize("motion", ["{type: shift, init: PATH, fixed: true}", "{type: constant, path: PATH}"])
def test_a_motion_is_that_of_a_file(frames, burst, motion, tmp_path):
    np.save(tmp_path / "motion.npy", burst.truth.motion.astype(np.float32))
    known = "physics.warp.motion=" + motion.replace("PATH", str(tmp_path / "motion.npy"))
    result = deepir.run("nuc", known, frames=frames, **QUICK)
    np.testing.assert_allclose(result.motion, burst.truth.motion, atol=1e-6)


@pytest.mark.parametrize(("read", "count"), [(0.001, 1), (5, 0)])
def test_noise_that_whole_counts_cannot_have_is_reported(frames, read, count):
    messages = deepir.run("nuc", f"noise.read={read}", "solver.max_iterations=1", frames=frames).messages
    assert sum("frames in [0, 1]" in each for each in messages) == count
