"""Runs from Python."""

import json
import re

import numpy as np
import pytest
import torch

import deepir
from deepir import burst
from deepir.config import Data, load
from deepir.errors import ConfigError, DataError
from deepir.simulate import Settings, simulate

QUICK = {"threads": 1, "solver": {"max_iterations": 3}}


@pytest.fixture(scope="module")
def sim():
    camera = Settings(n_frames=3, shape=(40, 48), counts=True, max_shift=4.0, motion="shift", dead_pixels=0.0)
    return simulate(None, camera, seed=3)


@pytest.fixture(scope="module")
def frames(sim):
    return sim.frames


def test_a_run_in_memory_writes_nothing(frames, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    result = deepir.run("nuc", frames=frames, prior="tv", **QUICK)
    assert result.scene.shape == (40, 48)
    assert list(tmp_path.iterdir()) == []


def test_the_same_run_gives_the_same_scene(frames):
    first, second = (deepir.run("nuc", frames=frames, **QUICK).scene for _ in range(2))
    assert np.array_equal(first, second)


@pytest.mark.parametrize(
    ("value", "why"), [(7, "7 everywhere (a shutter, or lost)"), (np.nan, "100% NaN or infinite")]
)
def test_a_frame_that_shows_nothing_is_left_out_and_reported(frames, value, why):
    damaged = np.insert(frames.astype(np.float32), 1, value, axis=0)
    result = deepir.run("nuc", frames=damaged, **QUICK)
    assert result.messages[0] == f"frame 1 is left out: it is {why}. Frames are counted without it"
    assert np.array_equal(result.scene, deepir.run("nuc", frames=frames, **QUICK).scene)


def test_that_results_are_relative_to_another_frame_is_reported(frames):
    damaged = np.insert(frames.astype(np.float32), 0, np.nan, axis=0)
    messages = deepir.run("nuc", frames=damaged, **QUICK).messages
    assert any("relative to what was frame 1" in message for message in messages)


@pytest.mark.parametrize("scenes", [2, 4])
def test_of_a_truth_for_each_frame_that_of_a_lost_one_goes_with_it(frames, tmp_path, scenes):
    damaged = np.insert(frames.astype(np.float32), 1, np.nan, axis=0)
    scene = np.arange(scenes)[:, None, None] * np.ones((40, 48))
    np.savez(tmp_path / "truth.npz", scene=scene, level=np.arange(4.0))
    truth = burst.load(Data(truth=str(tmp_path / "truth.npz")), frames=damaged).truth
    assert truth["level"].tolist() == [0, 2, 3]
    assert truth["scene"][:, 0, 0].tolist() == ([0, 2, 3] if scenes == 4 else [0, 1])


def test_too_few_frames_that_show_something_are_refused(frames):
    damaged = frames.astype(np.float32)
    damaged[1:] = 0
    with pytest.raises(DataError, match="frame 1 is 0 everywhere"):
        deepir.run("nuc", frames=damaged, **QUICK)


def test_frames_that_must_follow_each_other_are_all_wanted(frames):
    damaged = np.insert(frames.astype(np.float32), 1, np.nan, axis=0)
    with pytest.raises(DataError, match="frame 1 is 100% NaN"):
        deepir.run("deblur_lag", frames=damaged, **QUICK)


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
    with pytest.raises(ConfigError, match="already contains a run"):
        deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, **QUICK)
    deepir.run("nuc", frames=frames, output={"dir": tmp_path / "mine"}, overwrite=True, **QUICK)


def test_frames_from_memory_cannot_be_resumed(frames, tmp_path):
    from deepir.storage.stored import resume

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


@pytest.mark.parametrize("kind", [torch.bfloat16, torch.float64, torch.float32])
def test_frames_may_be_a_tensor_of_any_kind(frames, kind):
    tensor = torch.from_numpy(frames.astype(np.float32)).to(kind).requires_grad_()
    assert deepir.run("nuc", frames=tensor, **QUICK).scene.shape == (40, 48)


def test_what_no_frames_can_be_made_of_is_an_error(frames):
    for wrong in ([frames[0], frames[1][:20]], [frames[0], None], torch.empty(3, 40, 48, device="meta")):
        with pytest.raises(DataError, match="frames: no array"):
            deepir.run("nuc", frames=wrong)


def test_configurations_and_settings_of_another_kind_are_errors(frames):
    for config, settings, options in (
        (None, (), {}),
        (3, (), {}),
        ("nuc", (3,), {}),
        ("nuc", ({"seed": 3},), {}),
        ("nuc", (), {"data": {"truth": np.zeros((40, 48))}}),
    ):
        with pytest.raises(ConfigError, match=r"is needed|is text|name of its file"):
            deepir.run(config, *settings, frames=frames, **options)


def test_options_may_be_numbers_of_numpy(frames):
    assert load("nuc", (), {"seed": np.int64(3)}).seed == 3


def test_a_misspelt_option_is_an_error(frames):
    with pytest.raises(ConfigError, match="did you mean 'prior'"):
        deepir.run("nuc", frames=frames, piror="tv")


def test_frames_from_memory_are_selected_too(frames):
    result = deepir.run("nuc", "data.frames=[0, 2]", frames=frames, **QUICK)
    assert len(result.frames_used) == 2
    with pytest.raises(DataError, match="does not fit its 3 frames"):
        deepir.run("nuc", "data.frames=7", frames=frames, **QUICK)


@pytest.mark.parametrize("stage", ["warp", "sensor"])
def test_nuc_demands_what_it_estimates(frames, stage):
    with pytest.raises(ConfigError, match=f"needs a stage '{stage}'; or take problem=generic"):
        deepir.run("nuc", f"physics.{stage}=null", frames=frames, **QUICK)


def test_the_sensor_has_the_size_of_the_frames(frames):
    physics = {"blur": {"psf": "gaussian"}}  # after the sensor, which would then be larger
    with pytest.raises(ConfigError, match="stages that change the size go before 'sensor'"):
        deepir.run("nuc", frames=frames, physics=physics, **QUICK)


def test_a_field_that_cannot_be_the_scene_is_refused_in_plain_words(frames):
    with pytest.raises(ConfigError, match=r"'gaussian' does not fit: \(1, 1, \d+, \d+\) is wanted$"):
        deepir.run("nuc", frames=frames, prior="gaussian", **QUICK)


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
    one, other = (deepir.run("nuc", frames=each, **QUICK).scene for each in (masked, spoilt))
    np.testing.assert_array_equal(one, other)


def test_a_motion_is_registered_unless_it_says_otherwise(frames):
    physics = {"warp": {"motion": "shift"}, "sensor": {"gain": "pixel", "offset": "pixel"}}
    config = {"problem": "nuc", "physics": physics, **QUICK}
    named = deepir.run(config, frames=frames)
    said = deepir.run(config, "physics.warp.motion={type: shift, init: register}", frames=frames)
    np.testing.assert_array_equal(named.motion, said.motion)


@pytest.fixture
def motion(sim, tmp_path):
    """The true motion, in a file: with a wrong one the result would be given up."""
    motion = sim.truth.motion.astype(np.float32)
    np.save(tmp_path / "motion.npy", motion)
    return motion


def test_a_motion_starts_where_a_file_says(frames, motion, tmp_path):
    start = f"physics.warp.motion={{type: shift, init: {tmp_path / 'motion.npy'}, fixed: true}}"
    result = deepir.run("nuc", start, frames=frames, **QUICK)
    np.testing.assert_allclose(result.motion, motion, atol=1e-6)


def test_a_known_motion_is_taken_as_it_is(frames, motion, tmp_path):
    known = f"physics.warp.motion={{type: constant, path: {tmp_path / 'motion.npy'}}}"
    result = deepir.run("nuc", known, frames=frames, **QUICK)
    np.testing.assert_array_equal(result.motion, motion)


@pytest.mark.parametrize(
    ("setting", "says"),
    [
        ("physics.sensor.gain=0", "a gain has a positive mean"),
        ("physics.warp.motion=3", "the first frame's motion is the identity"),
    ],
)
def test_a_known_value_that_makes_no_sense_is_an_error(frames, setting, says):
    with pytest.raises(ConfigError, match=says):
        deepir.run("nuc", setting, frames=frames, **QUICK)


def test_noise_that_whole_counts_cannot_have_is_reported(burst):
    found_messages = [
        [
            each
            for each in deepir.run("nuc", *more, frames=burst.frames).messages
            if "frames in [0, 1]" in each
        ]
        for more in (
            ["noise.read=0.001", "solver.max_iterations=1"],
            ["noise.read=5", "solver.max_iterations=1"],
        )
    ]
    assert [len(each) for each in found_messages] == [1, 0]
