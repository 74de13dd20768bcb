"""Rows of numbers at an edge, torn frames and text that a camera draws are no picture; a picture's own rows are."""

import numpy as np
import pytest

import deepir
from deepir.io.frames import Frames
from deepir.io.inspection.checks import telemetry_rows, torn_frames, torn_message
from deepir.io.inspection.describe import describe
from deepir.io.inspection.samples import drawn_message, drawn_pixels
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural, sky


@pytest.fixture(scope="module")
def sim():
    return simulate(None, Settings(n_frames=6, shape=(96, 128), counts=True), seed=2)


@pytest.fixture
def frames(sim):
    return sim.frames.copy()


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
def test_rows_of_few_words_among_zeros_are_found(frames, rows):
    rng = np.random.default_rng(0)
    frames[:, rows] = 0
    frames[:, rows[0] : rows[-1] + 1, rng.choice(128, 4)] = rng.integers(0, 65536, (len(frames), len(rows), 4))
    assert telemetry_rows(frames) == rows


@pytest.mark.parametrize("picture", [procedural, sky])
@pytest.mark.parametrize("seed", range(6))
def test_whole_pictures_are_whole_and_their_edges_are_pictures(picture, seed):
    camera = Settings(n_frames=6, shape=(64, 80), counts=True, gain_row=0.05, offset_row=0.1)
    whole = simulate(picture(seed, (200, 250)), camera, seed=seed).frames
    assert telemetry_rows(whole) == []
    assert torn_frames(whole) == {}
    assert drawn_message(drawn_pixels(whole)) == []


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


def test_a_burst_with_telemetry_is_corrected_as_without():
    sim = simulate(None, Settings(n_frames=5, shape=(64, 80), counts=True), seed=2)
    result = deepir.run("nuc", frames=with_telemetry(sim.frames, [0, 1]), threads=1)
    assert any("rows 0, 1 show numbers" in message for message in result.messages)
    rest = np.where(np.arange(64)[:, None] < 2, np.nan, sim.truth.scene)
    assert scores(result.scene, rest)["psnr_aligned"] > 40


def test_what_a_file_holds_says_so_and_sees_the_motion(sim):
    lines = describe(Frames(with_telemetry(sim.frames, [95]).astype(np.float32), "burst.npz", "uint16", ""))
    assert any("data.crop=[0, 95, 0, 128]" in line for line in lines)
    assert any(line.startswith("motion: yes") for line in lines)


@pytest.mark.parametrize("row", [8, 40, 88])
def test_a_frame_that_ends_as_the_next_one_is_torn(frames, row):
    frames[3, row:] = frames[4, row:]
    assert torn_frames(frames) == {3: row}
    (message,) = torn_message({3: row}, 6)
    assert f"3 (at row {row})" in message
    assert "data.frames=[0, 1, 2, 4, 5]" in message


def test_a_frame_that_begins_as_the_one_before_is_torn(frames):
    frames[3, :40] = frames[2, :40]
    assert torn_frames(frames) == {3: 40}


def test_rows_that_stand_still_in_all_frames_are_not_torn(frames):
    frames[:, 60:] = frames[0, 60:]
    assert torn_frames(frames) == {}


def test_blocks_that_a_codec_leaves_as_they_were_are_not_torn(frames):
    rng = np.random.default_rng(0)
    for k in range(1, len(frames)):
        left = np.kron(rng.random((12, 16)) < 0.8, np.ones((8, 8), bool))
        left[80:] |= k == 3
        frames[k][left] = frames[k - 1][left]
    assert torn_frames(frames) == {}


def test_text_is_found_and_single_dead_pixels_are_none(frames):
    frames[:, 10:14, 20:40:2] = 16383
    frames[:, 10, 20:40] = 16383
    frames[:, 50, 60] = 0
    found = drawn_pixels(frames)
    assert found[10, 20:40].all()
    assert not found[50, 60]
    assert "between rows 10 and" in drawn_message(found)[0]


def test_frames_that_are_alike_show_nothing_drawn(frames):
    assert not drawn_pixels(frames[[0, 0, 0]]).any()
