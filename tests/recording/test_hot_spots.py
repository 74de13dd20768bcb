"""Small hot spots of the scene are no pattern: they survive the correction, still or moving, and leave no ghost."""

import numpy as np
import pytest

from deepir.correct_recording import correct

HEAT = 400.0  # counts; the pattern has 75
SPOTS = [(0.0, 0.0), (12.0, -16.0), (-14.0, 18.0)]  # px from the middle of the view


@pytest.fixture(scope="module")
def spotted(walk):
    """Frames, places (N, 6, 2) of spots 2 px wide, three of which stand in the world, scenes, and heat."""
    frames, scenes = walk.frames[:48, 30:94, 40:120].astype(float), walk.scenes[:48, 30:94, 40:120]
    time = np.linspace(0, 2 * np.pi, len(walk.frames))[:48]
    camera = np.stack(
        [
            90 * np.sin(0.61 * time) + 6 * np.sin(3.1 * time),
            70 * np.cos(0.87 * time) + 6 * np.cos(2.3 * time),
        ],
        1,
    )
    middle = np.array(frames.shape[1:]) / 2
    still = middle + np.array(SPOTS) - (camera - camera[24])[:, None]
    moving = middle + np.array(SPOTS) + np.outer(np.arange(48) - 24, [0.7, -1.1])[:, None]
    places = np.concatenate([still, moving], 1)
    rows, columns = np.indices(frames.shape[1:])
    heat = sum(
        HEAT
        * np.exp(
            -((rows - places[:, k, 0, None, None]) ** 2 + (columns - places[:, k, 1, None, None]) ** 2) / 0.9
        )
        for k in range(places.shape[1])
    )
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
        kept.append(
            found[k, y - 1 : y + 2, x - 1 : x + 2].sum() / heat[k, y - 1 : y + 2, x - 1 : x + 2].sum()
        )
    assert len(kept) > 100
    assert np.median(kept) == pytest.approx(1, abs=0.1)
    assert np.quantile(kept, 0.05) > 0.7
    cold = heat < 1
    passed = (heat > HEAT / 4).any(0) & (cold.sum(0) > 24)
    ghost = np.nanmedian(np.where(cold, found, np.nan)[:, passed], axis=0)
    assert abs(np.median(ghost)) < 0.05 * HEAT
