"""Where the motion is not to be trusted, the result is the first frame as it is, and no worse.

A pattern that looks like a picture was the scene.
"""

import numpy as np
import pytest
from skimage.data import camera

import deepir
from deepir.diagnostics.fit import scene_period
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import sky

X = np.mgrid[:400, :400][1]
FENCE = 0.1 + 0.8 * (X % 8 < 4)


def burst(scene=None, seed=0, **settings):
    return simulate(scene, Settings(n_frames=6, shape=(96, 96), motion="shift", **settings), seed=seed)


def period(frames):
    return scene_period(frames, np.ones(frames.shape, bool))


@pytest.mark.parametrize(("seed", "turn"), [pytest.param(0, 0.0, marks=pytest.mark.slow), (1, 2.0)])
def test_before_a_fence_the_result_is_no_worse_than_a_raw_frame(seed, turn):
    settings = Settings(n_frames=6, shape=(96, 128), motion="rigid" if turn else "shift", max_rotation=turn, scale=1.25)
    sim = simulate(FENCE, settings, seed=seed)
    result = deepir.run("nuc", frames=sim.frames, threads=1)
    raw, found = (scores(each, sim.truth.scene)["psnr_aligned"] for each in (sim.frames[0], result.scene))
    assert found > raw - 0.1
    assert "no correction" in result.messages[0]


def test_frames_that_are_mirrored_by_turns_get_no_correction():
    sim = burst(seed=1)
    frames = np.stack([each[:, ::-1] if k % 2 else each for k, each in enumerate(sim.frames)])
    result = deepir.run("nuc", frames=frames, threads=1)
    raw, found = (scores(each, sim.truth.scene)["psnr_aligned"] for each in (frames[0], result.scene))
    assert found > raw - 0.1
    assert "no correction" in result.messages[0]


def test_the_period_of_a_scene_is_found_below_a_fixed_pattern():
    assert period(burst(FENCE, scale=1.25).frames) == pytest.approx(6.4, rel=0.25)
    checks = 0.1 + 0.8 * ((X // 12 + X.T // 12) % 2)
    assert period(burst(checks, scale=1.5).frames) == pytest.approx(8 * 2**0.5, rel=0.25)


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_other_scenes_have_none(seed):
    assert period(burst(seed=seed).frames) is None
    edge = np.clip((X - 200) / 4, 0, 1)
    assert period(burst(edge, seed=seed, scale=1.25).frames) is None


def test_clouds_have_none():
    clean = {"shading": 0.0, "dead_pixels": 0.0, "level_drift": 0.0, "photons": 1000.0, "read_noise": 0.002}
    assert period(simulate(sky(20, (430, 500)), Settings(n_frames=5, **clean), seed=102).frames) is None


def looks_like_a_picture(result):
    return any("looks like a picture" in message for message in result.messages)


def test_a_camera_that_rests_before_somebody_who_walks_is_reported():
    rng = np.random.default_rng(3)
    scene = 8000 + 1500 / 255 * camera()[100:340:3, 100:412:3].astype(float)
    still = scene * (1 + rng.normal(0, 0.03, scene.shape)) + rng.normal(0, 60, scene.shape[1])
    frames = still + rng.normal(0, 3, (8, *scene.shape))
    for k, frame in enumerate(frames):
        frame[14:66, 6 + 9 * k : 20 + 9 * k] += 500
    assert looks_like_a_picture(deepir.run("nuc", frames=frames, threads=1))


def test_dust_on_the_window_is_no_picture():
    sim = simulate(None, Settings(n_frames=6, shape=(96, 128), counts=True), seed=1)
    y, x = np.mgrid[:96, :128]
    places = np.random.default_rng(0).uniform(0, [96, 128], (40, 2))
    dust = sum(np.exp(-((y - row) ** 2 + (x - column) ** 2) / 8) for row, column in places)
    assert not looks_like_a_picture(deepir.run("nuc", frames=sim.frames + 800 * dust, threads=1))
