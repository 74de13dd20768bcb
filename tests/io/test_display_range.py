"""Pictures of an automatic gain: each frame has a contrast and a level of its own, and is cut off at both ends."""

import dataclasses
import functools

import numpy as np
import pytest
import skimage.data

import deepir
from deepir.diagnostics.fit import is_equalised
from deepir.io.inspection.samples import clipped_samples, is_contrast_stretched
from deepir.metrics import scores
from deepir.optim.solve import Progress
from deepir.simulate import Settings, simulate

CAMERA = Settings(n_frames=6, shape=(80, 96), counts=True, shading=0.0, dead_pixels=0.002)


def automatic_gain(frames, bits=8):
    """Each frame from black, at its darkest hundredth, to white, at its brightest."""
    low, high = np.percentile(frames, (1, 99), axis=(1, 2))[:, :, None, None]
    return np.rint(np.clip((frames - low) / (high - low), 0, 1) * (2**bits - 1))


@functools.cache
def solved(seed):
    """A simulated burst, its pictures, and what is found of them."""
    sim = simulate(None, CAMERA, seed=seed)
    pictures = automatic_gain(sim.frames).astype(np.uint8)
    return sim, pictures, deepir.run("nuc", frames=pictures, threads=1)


@pytest.mark.parametrize("seed", [4, 7, pytest.param(9, marks=pytest.mark.slow)])
def test_an_automatic_gain_is_undone(seed):
    sim, pictures, result = solved(seed)
    average = deepir.run("nuc", frames=pictures, method="average", threads=1)
    found, usual = (scores(each.scene, sim.truth.scene)["psnr_aligned"] for each in (result, average))
    assert found > usual + 10


def test_a_gain_that_changes_much_is_reported():
    frames = simulate(None, CAMERA, seed=3).frames
    middle, factor = np.median(frames), np.array([1, 0.9, 1.2, 1, 1.1, 0.8])[:, None, None]
    stretched = np.rint(128 + (frames - middle) / np.ptp(frames) * 150 * factor)
    messages = deepir.run("nuc", frames=stretched, threads=1).messages
    assert any("automatic gain" in message and "20%" in message for message in messages)


def test_who_walks_through_pictures_does_not_pass_for_their_contrast():
    camera = dataclasses.replace(CAMERA, shape=(96, 128), dead_pixels=0.0)
    sim = simulate(skimage.data.camera() / 255, camera, seed=4)
    y, x = np.mgrid[:96, :128]
    walks = [((x - 15 - 12 * k) / 6) ** 2 + ((y - 45) / 18) ** 2 < 1 for k in range(6)]
    tones = (sim.frames - float(sim.frames.min())) / np.ptp(sim.frames)
    pictures = [np.rint(255 * each) for each in (tones, np.where(walks, 0.8, tones))]
    alone, both = (
        scores(deepir.run("nuc", frames=each, threads=1).scene, sim.truth.scene)["psnr_aligned"] for each in pictures
    )
    assert both > alone - 1


def test_an_interrupted_run_on_such_pictures_goes_on_to_the_same_result(tmp_path):
    _, pictures, whole = solved(4)
    np.save(tmp_path / "film.npy", pictures)
    data = {"path": str(tmp_path / "film.npy")}

    def stop(progress: Progress) -> None:
        if progress.stage == "sensor 3":
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        deepir.run("nuc", data=data, output={"dir": str(tmp_path / "run")}, threads=1, callbacks=[stop])
    np.testing.assert_array_equal(deepir.storage.stored.resume(tmp_path / "run").scene, whole.scene)


def test_eight_bits_and_frames_of_one_range_are_stretched_and_counts_are_not():
    frames = np.random.default_rng(0).normal(8000, 100, (4, 32, 40))
    low, high = (end(frames, axis=(1, 2), keepdims=True) for end in (np.min, np.max))
    assert is_contrast_stretched(automatic_gain(frames))
    assert is_contrast_stretched((frames - low) / (high - low))
    assert not is_contrast_stretched(frames)
    frames[:, 5, 7], frames[:, 9, 9] = 0, 16383  # dead pixels are at the ends of the range in all frames
    assert not is_contrast_stretched(frames)


def test_what_is_black_in_most_of_a_frame_is_no_clipping():
    frames = np.zeros((2, 16, 16))
    frames[0, :4], frames[1, :12] = np.arange(16), np.arange(1, 17)
    cut = clipped_samples(frames)
    assert not cut[0].any()
    assert cut[1].sum() == 4 * 16 + 12


def equalised(frames):
    """Each sample's rank within its frame, in 8 bits."""
    ranks = [np.searchsorted(np.sort(frame, None), frame, "right") / frame.size for frame in frames]
    return np.rint(255 * np.array(ranks))


@pytest.mark.parametrize("shape", [(24, 32), (80, 96)])
def test_an_equalised_histogram_is_detected_and_no_other_picture_is_taken_for_one(shape):
    frames = simulate(None, dataclasses.replace(CAMERA, shape=shape), seed=3).frames
    fixed = np.rint((frames - frames.min()) / np.ptp(frames) * 255)
    assert is_equalised(equalised(frames))
    assert not any(is_equalised(each) for each in (frames, fixed, automatic_gain(frames)))


def test_what_an_equalised_histogram_means_is_said():
    messages = deepir.run("nuc", frames=equalised(simulate(None, CAMERA, seed=3).frames), threads=1).messages
    assert any("ranks, not flux" in message for message in messages)
