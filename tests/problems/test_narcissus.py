"""Stray flux in front of the sensor: what tells it from the scene, and what does not."""

import numpy as np
import pytest
import torch
from small_problems import whole

import deepir
from deepir.assembly import build
from deepir.burst import Burst
from deepir.config import load
from deepir.effects import frame_gain
from deepir.errors import ConfigError, DataError
from deepir.estimation.prior_weight import adapt_weight_map
from deepir.fields.basis_expansion import DCT, Radial
from deepir.metrics import scores
from deepir.problems import narcissus as module
from deepir.problems.initial_estimate import start_scene
from deepir.problems.narcissus import Narcissus, tv_minimising_fit
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

CAMERA = {
    "shape": (64, 80), "max_shift": 8.0, "shading": 0.0, "photons": 1000.0, "read_noise": 0.002, "dead_pixels": 0.0,
}  # fmt: skip


def record(shape, stray=1.0, seed=1, **more):
    scene = procedural(seed, (300, 360))
    return simulate(scene, Settings(**CAMERA | {"stray": stray, "stray_shape": shape} | more), seed=seed)


def psnr(result, sim):
    return scores(result.scene, sim.truth.scene)["psnr_aligned"]


# ---- physics ----


@pytest.mark.parametrize("shape", ["smooth", "radial", "ring", "edge"])
def test_what_stays_while_the_scene_moves_is_stray_flux(shape):
    sim = record(shape)
    result = deepir.run("narcissus", frames=sim.frames, threads=1)
    plain = deepir.run("nuc", frames=sim.frames, threads=1)
    assert result.messages == []
    error = (result.extra["stray"] - sim.truth.stray).std()
    assert error < 0.25 * sim.truth.stray.std()
    assert psnr(result, sim) > 35
    assert psnr(result, sim) > psnr(plain, sim) + 1


def test_stray_flux_four_times_as_strong_as_the_scene():
    sim = record("ring", stray=4.0, seed=2)
    result = deepir.run("narcissus", frames=sim.frames, threads=1)
    assert (result.extra["stray"] - sim.truth.stray).std() < 0.1 * sim.truth.stray.std()
    assert psnr(result, sim) > 33


def test_without_stray_flux_none_is_found():
    sim = record("smooth", stray=0.0)
    result = deepir.run("narcissus", frames=sim.frames, threads=1)
    assert np.abs(result.extra["stray"]).max() < 0.02
    assert psnr(result, sim) > psnr(deepir.run("nuc", frames=sim.frames, threads=1), sim) - 0.5


def test_a_scene_is_as_plain_behind_a_steep_stray_flux_as_without():
    sim = record("radial", stray=4.0)
    burst = Burst(sim.frames, np.ones(sim.frames.shape, bool), sim.truth.bad_pixels)
    problem, _ = build(load("narcissus"), burst, torch.from_numpy(sim.truth.motion))
    start_scene(problem)
    found = []
    for strength in (0.0, 1.0):
        problem.fields["stray"].sigma.fill_(strength)
        problem.fields["stray"].init_from(torch.from_numpy(sim.truth.stray).float())
        adapt_weight_map(problem)
        found.append(problem.penalties["scene"]["tv"].weight_map.clone())
    assert torch.equal(*found)


def test_behind_a_known_gain_stray_flux_is_separated_from_the_offset_by_the_gain_alone(tmp_path):
    """`g s` repeats the gain's pattern, an offset does not: that is all there is to tell them apart."""
    sim = record("smooth", offset_pixel=0.0, offset_column=0.0, offset_row=0.0)
    np.savez(tmp_path / "maps.npz", gain=sim.truth.gain, offset=sim.truth.offset)
    known = f"physics.sensor.gain={{type: constant, path: {tmp_path / 'maps.npz'}, key: gain}}"
    result = deepir.run("narcissus", known, "physics.sensor.offset=0", frames=sim.frames, threads=1)
    assert (result.extra["stray"] - sim.truth.stray).std() < 0.03 * sim.truth.stray.std()
    np.testing.assert_allclose(result.gain, sim.truth.gain, rtol=1e-5)


def test_behind_a_known_sensor_stray_flux_is_found_too(tmp_path):
    sim = record("ring", photons=0.0)
    np.savez(tmp_path / "maps.npz", gain=sim.truth.gain, offset=sim.truth.offset)
    known = [
        f"physics.sensor.{name}={{type: constant, path: {tmp_path / 'maps.npz'}, key: {name}}}"
        for name in ("gain", "offset")
    ]
    result = deepir.run("narcissus", *known, frames=sim.frames, threads=1)
    assert (result.extra["stray"] - sim.truth.stray).std() < 0.1 * sim.truth.stray.std()


def test_about_a_known_axis_few_numbers_are_enough():
    y, x = np.mgrid[:64, :80] - np.array([31.5, 39.5])[:, None, None]
    stray = np.exp(-np.square(np.hypot(y, x) - 20) / 30)
    sim = record("smooth", stray=0.0)
    frames = sim.frames + (sim.truth.gain * stray).astype(np.float32)
    changes = ["physics.stray.value={type: radial, order: 20}"]
    result = deepir.run("narcissus", *changes, frames=frames, threads=1)
    assert (result.extra["stray"] - (stray - stray.mean())).std() < 0.1 * stray.std()


def test_the_result_explains_the_frames_in_the_gauge():
    """Gain one and stray flux zero in the mean, and `g (x + s) + o + l` is frame 0."""
    sim = record("radial", counts=True, photons=0.0, read_noise=0.003, pedestal=4000.0)
    result = deepir.run("narcissus", frames=sim.frames, threads=1)
    good = ~result.bad_pixels
    assert result.gain[good].mean() == pytest.approx(1, abs=1e-5)
    assert result.extra["stray"][good].mean() == pytest.approx(0, abs=1e-2)
    explained = result.gain * (result.scene + result.extra["stray"]) + result.offset + result.level[0]
    assert np.median(np.abs(explained - sim.frames[0])) < 1.5 * 0.003 * 1500


# ---- one frame ----


@pytest.mark.parametrize("field", [DCT((1, 1, 60, 80)), Radial((1, 1, 60, 80))], ids=["dct", "radial"])
def test_in_a_scene_of_flat_parts_one_frame_shows_its_stray_flux(field):
    with torch.no_grad():
        field.sigma.fill_(1.0)
        field.values.copy_(torch.randn(len(field.values)) * (field.frequency < 5))
    stray = field().detach()[0, 0]
    scene = torch.zeros(60, 80)
    scene[15:40, 20:50], scene[30:55, 45:70] = 3.0, -2.0
    usable = torch.rand(60, 80) > 0.05
    frame = torch.where(usable, scene + stray + 0.01 * torch.randn(60, 80), torch.tensor(50.0))
    found = tv_minimising_fit(frame, usable, field)
    assert float((found - stray).std()) < 0.15 * float(stray.std())


def test_from_one_frame_a_slope_of_the_scene_is_stray_flux_and_it_is_said():
    y, _ = np.mgrid[:64, :80]
    frame = 300 + 0.5 * y + np.random.default_rng(0).normal(0, 0.1, (64, 80))
    result = deepir.run("narcissus", frames=frame[None], threads=1)
    assert np.ptp(result.extra["stray"]) > 25
    assert np.ptp(result.scene) < 6
    assert result.messages[0].startswith("one frame: only its smoothness separates stray flux")
    np.testing.assert_array_equal(result.gain, 1)


# ---- what it says ----


def test_two_frames_are_not_enough_and_it_is_said():
    sim = record("smooth", n_frames=2)
    result = deepir.run("narcissus", frames=sim.frames, threads=1)
    assert not result.extra["stray"].any()
    assert any("Take 3 or more" in message for message in result.messages)


def test_frames_that_stand_still_are_refused():
    frame = record("smooth").frames[0]
    with pytest.raises(DataError, match="the frames do not move"):
        deepir.run("narcissus", frames=np.stack([frame] * 4))


def test_stray_flux_that_is_free_at_each_pixel_is_refused():
    with pytest.raises(ConfigError, match=r"^physics.stray.value: stray flux that is free at each pixel is"):
        deepir.run("narcissus", "physics.stray.value=pixels", frames=record("smooth").frames)


# ---- its stages, edited by name from those of nuc ----


def stages(*settings):
    sim = record("smooth", n_frames=5)
    motion = torch.eye(3, dtype=torch.float64).repeat(5, 1, 1)
    problem, _ = build(load("narcissus", settings), whole(sim.frames), motion)
    return {stage.name: stage for stage in Narcissus().plan(problem)}


def test_a_response_that_drifts_is_corrected_before_its_rounds(monkeypatch):
    called = []
    monkeypatch.setattr(module, "_register", lambda problem: called.append("register"))
    monkeypatch.setattr(frame_gain, "correct_gain_drift", lambda problem: called.append("even"))
    monkeypatch.setattr(Narcissus, "update", lambda self, problem: None)
    stages()["response 2"].prepare(None)
    assert called == ["register", "even"]


def test_where_lines_may_jump_the_scene_is_fitted_at_its_full_weight_too():
    plan = stages("physics.sensor.level.type=drift+row_noise")
    assert plan["scene 1"].prepare.__func__ is Narcissus.finish
    assert "scene 3" in plan
