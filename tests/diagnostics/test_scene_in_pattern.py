"""A pattern that looks like a picture was the scene."""

import numpy as np
import pytest
from skimage.data import camera

import deepir
from deepir.simulate import Settings, simulate


def said(result):
    return any("looks like a picture" in message for message in result.messages)


def test_a_camera_that_rests_before_somebody_who_walks_is_reported():
    rng = np.random.default_rng(3)
    scene = 8000 + 1500 / 255 * camera()[100:340:3, 100:412:3].astype(float)
    still = scene * (1 + rng.normal(0, 0.03, scene.shape)) + rng.normal(0, 60, scene.shape[1])
    frames = still + rng.normal(0, 3, (8, *scene.shape))
    for k, frame in enumerate(frames):
        frame[14:66, 6 + 9 * k : 20 + 9 * k] += 500
    assert said(deepir.run("nuc", frames=frames, threads=1))


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_the_pattern_of_a_camera_that_moves_is_none(seed):
    sim = simulate(None, Settings(n_frames=5, shape=(96, 128), counts=True), seed=seed)
    assert not said(deepir.run("nuc", frames=sim.frames, threads=1))


def test_dust_on_the_window_is_no_picture():
    sim = simulate(None, Settings(n_frames=6, shape=(96, 128), counts=True), seed=1)
    y, x = np.mgrid[:96, :128]
    places = np.random.default_rng(0).uniform(0, [96, 128], (40, 2))
    dust = sum(np.exp(-((y - row) ** 2 + (x - column) ** 2) / 8) for row, column in places)
    assert not said(deepir.run("nuc", frames=sim.frames + 800 * dust, threads=1))
