"""How sure a result is: of the size of its error, and larger where less is known."""

import functools
import math

import numpy as np
import pytest

from tests.effects import solved as bursts

solved = functools.partial(bursts.solved, seed=2, shape=(64, 80))


@pytest.mark.parametrize("n_frames", [3, 8])
def test_errors_of_the_scene_are_of_the_size_that_it_says(n_frames):
    result, sim = solved(n_frames=n_frames)
    error = result.scene - sim.truth.scene
    error -= np.median(error)
    ratio = 1.4826 * np.median(np.abs(error / result.uncertainty["scene"]))
    assert 0.5 < ratio < 2


def test_what_fewer_frames_show_is_less_sure():
    result, _ = solved(max_shift=20.0)
    sigma = result.uncertainty["scene"]
    assert sigma[0].mean() > 1.2 * sigma[32].mean()


def test_more_frames_make_the_pattern_cheaper_and_motion_along_one_axis_dearer():
    few, many, along_x = (
        solved(**each)[0].metrics["pattern_cost_db"] for each in ({"n_frames": 3}, {"n_frames": 8}, {"jitter": "x"})
    )
    assert few > 10 * math.log10(3 / 2)
    assert many < few
    assert along_x > few


def test_maps_have_the_shape_of_what_they_are_about():
    result, _ = solved()
    for name in ("scene", "gain", "offset"):
        assert result.uncertainty[name].shape == getattr(result, name).shape
        assert (result.uncertainty[name] > 0).all()
