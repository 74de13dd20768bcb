"""Samples that are NaN in some frames cost their information, and nothing else."""

import numpy as np

import deepir
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

TONES = Settings(shape=(96, 128), n_frames=5, shading=0.0, dead_pixels=0.0, photons=1000.0, read_noise=0.002)


def psnr(frames, sim):
    return scores(deepir.run("nuc", frames=frames, threads=1).scene, sim.truth.scene)["psnr_aligned"]


def test_the_scene_behind_a_masked_object_is_restored_from_the_few_frames_that_show_it():
    slow = Settings(**vars(TONES) | {"walker": 0.8, "walker_contrast": 0.5, "walker_speed": 5.0})
    lost = []
    for seed in (2, 4):
        walks, nobody = (simulate(procedural(seed, (300, 380)), each, seed=seed) for each in (slow, TONES))
        cut_out = np.where(walks.truth.moving, np.nan, walks.frames)
        lost.append(psnr(nobody.frames, nobody) - psnr(cut_out, walks))
    assert np.mean(lost) < 4  # 6.4 if what most frames lack is left out of all


def test_a_third_of_the_samples_may_be_lost_anywhere():
    sim = simulate(procedural(6, (300, 380)), TONES, seed=6)
    whole = deepir.run("nuc", frames=sim.frames, threads=1)
    assert "unseen" not in whole.extra
    lost = np.random.default_rng(0).random(sim.frames.shape) < 1 / 3
    quality = scores(whole.scene, sim.truth.scene)["psnr_aligned"]
    assert psnr(np.where(lost, np.nan, sim.frames), sim) > quality - 3


def test_pixels_without_any_sample_are_bad_and_what_no_frame_shows_is_marked():
    frames = simulate(procedural(1, (300, 380)), TONES, seed=1).frames.copy()
    frames[1:, 40:44, 82:86] = np.nan
    lost = np.zeros(frames.shape[1:], bool)
    lost[:, 40:70] = lost[60:62, 20:22] = True
    frames[:, lost] = np.nan
    result = deepir.run("nuc", "prior=tv", frames=frames, threads=1)
    np.testing.assert_array_equal(result.bad_pixels, lost)
    unseen = result.extra["unseen"]
    assert unseen[:, 54:57].all()
    assert not unseen[:, :40].any()
    assert not unseen[:, 70:].any()
    assert any("seen by no frame" in message for message in result.messages)
