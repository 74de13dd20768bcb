"""Non-uniformity correction where little is seen."""

import numpy as np
import pytest
from scipy import ndimage

import deepir
from deepir.metrics import scores
from deepir.operators.warp import NOISE_GAIN
from deepir.priors.penalties.tv import TV
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural, sky


def test_a_corner_that_one_frame_alone_shows_is_what_it_shows():
    camera = Settings(
        n_frames=10, counts=True, read_noise=0.003, shading=0.0, dead_pixels=0.0,
        offset_column=0.1, offset_pixel=0.1, max_rotation=3.0,
    )  # fmt: skip
    sim = simulate(procedural(6, (430, 500)), camera, seed=13)
    error = deepir.run("nuc", frames=sim.frames, threads=1).scene - sim.truth.scene
    # The pattern is some 300 counts a pixel; a corner that was made up had been off by 750.
    assert np.abs(error - np.median(error)).max() < 100


def test_a_plain_scene_bears_a_stronger_prior_than_a_rich_one():
    camera = Settings(n_frames=5, shape=(96, 120), photons=1000.0, shading=0.0, dead_pixels=0.0)
    texture = ndimage.gaussian_filter(np.random.default_rng(0).random((260, 300)), 1.5)
    found = []
    for picture in (ndimage.gaussian_filter(procedural(6, (260, 300)), 5.0), texture / texture.max()):
        sim = simulate(picture, camera, seed=14)
        metrics = deepir.run("nuc", prior="tv", frames=sim.frames, threads=1).metrics
        by_noise = TV().default_weight(NOISE_GAIN * metrics["noise_sigma"] / 5**0.5)
        found.append(metrics["strengths"]["scene.tv.weight"] / by_noise)
    plain, rich = found
    assert 1.15 * rich < plain < 8


KNOWN_GAIN = {"type": "constant", "path": "gain.npy"}
DARK = procedural(6, (260, 300)) ** 3  # photons are few, and noise little, in half of it


@pytest.mark.parametrize(
    ("changes", "seed", "known", "margin"),
    [
        ({"n_frames": 5, "gain_column": 0.3}, 15, {"physics": {"sensor": {"gain": KNOWN_GAIN}}}, 0.2),
        ({"n_frames": 3, "read_noise": 0.002}, 16, {"noise": {"read": 0.002, "photons": 1000.0}}, 1.0),
    ],
)
def test_gain_or_noise_that_is_known_is_next_to_no_worse_than_found(
    changes, seed, known, margin, tmp_path, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    sim = simulate(DARK, Settings(**changes, shape=(96, 120), photons=1000.0, shading=0.0, dead_pixels=0.0), seed=seed)
    np.save("gain.npy", sim.truth.gain)
    found, with_truth = (
        scores(deepir.run("nuc", frames=sim.frames, threads=1, **more).scene, sim.truth.scene)["psnr_aligned"]
        for more in ({}, known)
    )
    assert with_truth > found - margin


def test_a_pattern_many_times_stronger_than_the_scene_is_taken_out():
    pattern = {"contrast": 300, "offset_pixel": 6.0, "offset_column": 4.0}
    camera = Settings(n_frames=6, shape=(64, 80), counts=True, read_noise=0.02, dead_pixels=0.0, **pattern)
    sim = simulate(None, camera, seed=4)
    error = deepir.run("nuc", frames=sim.frames, threads=1).scene - sim.truth.scene
    assert np.std(sim.truth.offset) > 5 * sim.settings.contrast
    assert error.std() < 0.02 * sim.settings.contrast


def test_a_plain_scene_before_a_clear_pattern_keeps_its_contrast():
    # What changes in a pixel as the camera moves is small beside the pattern: gains that are too small explain it, too.
    pattern = {"gain_pixel": 0.02, "gain_column": 0.0, "offset_pixel": 0.1, "offset_column": 0.05, "offset_row": 0.05}
    camera = Settings(n_frames=6, shape=(96, 128), max_shift=4.0, shading=0.0, read_noise=0.001, **pattern)
    sim = simulate(sky(3, (300, 380)), camera, seed=2)
    scene = deepir.run("nuc", frames=sim.frames, threads=1).scene
    gain, _ = np.polyfit(scene.ravel(), sim.truth.scene.ravel(), 1)
    assert abs(gain - 1) < 0.02
    assert scores(scene, sim.truth.scene)["psnr_aligned"] > 50


@pytest.mark.parametrize("rows", [False, True])
def test_lost_samples_or_rows_and_the_bars_of_a_film_cost_little(rows):
    sim = simulate(None, Settings(n_frames=5, shape=(80, 96), counts=True, shading=0.0), seed=2)
    frames = sim.frames.astype(np.float32)
    if rows:
        frames[2, 40:44] = frames[3, 60:] = 0
        frames[:, :8] = frames[:, -8:] = 16
    else:
        frames[np.random.default_rng(0).random(frames.shape) < 0.02] = np.nan
        frames[2, 10:20, 30:40] = np.inf
    error = (deepir.run("nuc", frames=frames, threads=1).scene - sim.truth.scene)[10:-10]
    assert (error - error.mean()).std() < 0.02 * sim.settings.contrast


@pytest.mark.parametrize("seed", [2, 3])
def test_small_frames_that_bend_move_by_homographies(seed):
    sim = simulate(None, Settings(motion="homography", n_frames=6, shape=(64, 80), max_shift=5.0), seed=seed)
    found, told = (
        deepir.run("nuc", f"physics.warp.motion.type={kind}", frames=sim.frames, threads=1)
        for kind in ("auto", "homography")
    )
    error, least = (np.std(each.scene - sim.truth.scene) for each in (found, told))
    assert error < 1.1 * least
