"""Small hot spots of the scene are no pattern: they survive the correction, still or moving, and leave no ghost."""

import numpy as np
import pytest

from deepir.correct_recording import correct

HEAT = 400.0  # counts; the pattern has 75
SPOTS = [(0.0, 0.0), (12.0, -16.0), (-14.0, 18.0)]  # px from the middle of the view


@pytest.fixture(scope="module")
def spotted(walk):
    """Frames, places (N, 6, 2) of spots 2 px wide, three of which stand in the world, scenes, and heat."""
    frames, scenes = walk.frames[:48, 8:72, 16:96].astype(float), walk.scenes[:48, 8:72, 16:96]
    time = np.linspace(0, 2 * np.pi, len(walk.frames))[:48]
    y, x = (90 * np.sin(0.61 * time) + 6 * np.sin(3.1 * time), 70 * np.cos(0.87 * time) + 6 * np.cos(2.3 * time))
    camera = np.stack([y, x], 1)
    middle = np.array(frames.shape[1:]) / 2
    still = middle + np.array(SPOTS) - (camera - camera[24])[:, None]
    moving = middle + np.array(SPOTS) + np.outer(np.arange(48) - 24, [0.7, -1.1])[:, None]
    places = np.concatenate([still, moving], 1)
    rows, columns = np.indices(frames.shape[1:])
    y, x = places[..., 0, None, None], places[..., 1, None, None]
    heat = (HEAT * np.exp(-((rows - y) ** 2 + (columns - x) ** 2) / 0.9)).sum(1)
    return frames + heat, places, scenes, heat


def test_small_hot_spots_survive_and_leave_no_ghost(spotted):
    frames, places, scenes, heat = spotted
    corrected = correct(frames.round().astype(np.uint16))
    found = corrected.frames - scenes
    found -= np.median(found, axis=(1, 2), keepdims=True)
    inside = ((places >= 3) & (places < np.array(frames.shape[1:]) - 3)).all(-1)
    kept = []
    for k, spot in zip(*np.nonzero(inside), strict=True):
        y, x = places[k, spot].round().astype(int)
        about = np.s_[k, y - 1 : y + 2, x - 1 : x + 2]
        kept.append(found[about].sum() / heat[about].sum())
    assert len(kept) > 100
    assert np.median(kept) == pytest.approx(1, abs=0.1)
    assert np.quantile(kept, 0.05) > 0.7
    cold = heat < 1
    passed = (heat > HEAT / 4).any(0) & (cold.sum(0) > 24)
    ghost = np.nanmedian(np.where(cold, found, np.nan)[:, passed], axis=0)
    assert abs(np.median(ghost)) < 0.05 * HEAT
