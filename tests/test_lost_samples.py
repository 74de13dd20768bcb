"""Samples that are NaN in some frames cost their information, and nothing else."""

import numpy as np

import deepir
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural

TONES = Settings(shape=(96, 128), n_frames=5, shading=0.0, dead_pixels=0.0, photons=1000.0, read_noise=0.002)


def psnr(frames, sim):
    return scores(deepir.run("nuc", frames=frames).scene, sim.truth.scene)["psnr_aligned"]


def test_what_shows_behind_somebody_who_is_cut_out_counts_even_if_few_frames_show_it():
    slow = Settings(**vars(TONES) | {"walker": 0.8, "walker_contrast": 0.5, "walker_speed": 5.0})
    lost = []
    for seed in (2, 4):
        walks, nobody = (simulate(procedural(seed, (300, 380)), each, seed=seed) for each in (slow, TONES))
        cut_out = np.where(walks.truth.moving, np.nan, walks.frames)
        lost.append(psnr(nobody.frames, nobody) - psnr(cut_out, walks))
    assert np.mean(lost) < 4  # 6.4 if what most frames lack is left out of all


def test_a_third_of_the_samples_may_be_lost_anywhere():
    sim = simulate(procedural(6, (300, 380)), TONES, seed=6)
    lost = np.random.default_rng(0).random(sim.frames.shape) < 1 / 3
    assert psnr(np.where(lost, np.nan, sim.frames), sim) > psnr(sim.frames, sim) - 3


def test_a_pixel_is_bad_that_has_no_sample_at_all():
    sim = simulate(procedural(1, (300, 380)), TONES, seed=1)
    frames = sim.frames.copy()
    frames[1:, 40:44, 50:54] = np.nan
    frames[:, 60:62, 20:22] = np.nan
    assert np.argwhere(deepir.run("nuc", frames=frames).bad_pixels).tolist() == [
        [60, 20],
        [60, 21],
        [61, 20],
        [61, 21],
    ]


def test_what_no_frame_shows_of_the_scene_is_marked():
    sim = simulate(procedural(1, (300, 380)), TONES, seed=1)
    frames = sim.frames.copy()
    frames[..., 40:70] = np.nan
    result = deepir.run("nuc", frames=frames, threads=1)
    unseen = result.extra["unseen"]
    assert unseen[:, 54:57].all()
    assert not unseen[:, :40].any()
    assert not unseen[:, 70:].any()
    assert any("seen by no frame" in message for message in result.messages)
    assert "unseen" not in deepir.run("nuc", frames=sim.frames, threads=1).extra
