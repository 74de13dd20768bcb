"""Rows of numbers at an edge are no picture, and are left out; a picture's own rows are not."""

import numpy as np
import pytest

import deepir
from deepir.io.frames import Frames
from deepir.io.inspection.checks import telemetry_rows
from deepir.io.inspection.describe import describe
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural, sky


@pytest.fixture(scope="module")
def sim():
    return simulate(None, Settings(n_frames=5, shape=(96, 128), counts=True), seed=2)


def with_telemetry(frames, rows, share=1.0, seed=0):
    """Frames with random words of 16 bits in these rows, the other words of which do not change."""
    rng = np.random.default_rng(seed)
    frames = frames.copy()
    words = np.broadcast_to(rng.integers(0, 100, (len(rows), frames.shape[2])), frames[:, rows].shape)
    changing = rng.random(words.shape) < share
    frames[:, rows] = np.where(changing, rng.integers(0, 65536, words.shape), words)
    return frames


@pytest.mark.parametrize("rows", [[0], [95], [0, 1], [93, 94, 95], [0, 94, 95]])
@pytest.mark.parametrize("share", [1.0, 0.3])
def test_rows_of_words_are_found(sim, rows, share):
    assert telemetry_rows(with_telemetry(sim.frames, rows, share)) == rows


@pytest.mark.parametrize("rows", [[0], [95], [0, 1, 2, 3], [92, 93, 94, 95]])
def test_rows_of_few_words_among_zeros_are_found(sim, rows):
    rng, frames = np.random.default_rng(0), sim.frames.copy()
    frames[:, rows] = 0
    frames[:, rows[0] : rows[-1] + 1, rng.choice(128, 4)] = rng.integers(0, 65536, (len(frames), len(rows), 4))
    assert telemetry_rows(frames) == rows


@pytest.mark.parametrize("picture", [procedural, sky])
@pytest.mark.parametrize("seed", range(6))
def test_the_edge_of_a_picture_is_a_picture(picture, seed):
    camera = Settings(n_frames=3, shape=(64, 80), counts=True, gain_row=0.05, offset_row=0.1)
    assert telemetry_rows(simulate(picture(seed, (200, 250)), camera, seed=seed).frames) == []


@pytest.mark.parametrize("lost", [slice(0, 46), slice(-46, None), slice(0, 48)])
def test_what_is_left_of_frames_that_are_half_lost_is_a_picture(sim, lost):
    frames = sim.frames.astype(np.float32)
    frames[:, lost] = np.nan
    assert telemetry_rows(frames) == []
    far = [95] if lost.start == 0 else [0]
    assert telemetry_rows(with_telemetry(frames, far)) == far


def test_frames_of_few_rows_and_lost_samples_do_no_harm():
    assert telemetry_rows(np.full((2, 16, 20), np.nan, np.float32)) == []
    assert telemetry_rows(np.zeros((1, 8, 20), np.float32)) == []


def test_a_burst_with_telemetry_is_corrected_as_without(sim):
    result = deepir.run("nuc", frames=with_telemetry(sim.frames, [0, 1]), threads=1)
    assert any("rows 0, 1 show numbers" in message for message in result.messages)
    rest = np.where(np.arange(96)[:, None] < 2, np.nan, sim.truth.scene)
    assert scores(result.scene, rest)["psnr_aligned"] > 40


def test_what_a_file_holds_says_so_and_sees_the_motion(sim):
    lines = describe(Frames(with_telemetry(sim.frames, [95]).astype(np.float32), "burst.npz", "uint16", ""))
    assert any("data.crop=[0, 95, 0, 128]" in line for line in lines)
    assert any(line.startswith("motion: yes") for line in lines)
