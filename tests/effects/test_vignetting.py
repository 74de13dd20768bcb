"""A lens that vignettes shades the gain: it is found where it is, and not where something else is smooth."""

import pytest

from tests.effects.solved import psnr, solved

TONES = {"counts": False, "photons": 1000.0, "read_noise": 0.002}
COUNTS = {"counts": True}


def run(*settings, n_frames=6, **camera):
    return solved(*settings, seed=2, n_frames=n_frames, max_shift=8.0, **camera)


def strength(result):
    return result.metrics["strengths"]["gain.shading.sigma"]


@pytest.mark.parametrize(("camera", "better"), [(TONES, 1.0), (COUNTS, 3.0)])
def test_a_shaded_gain_is_found(camera, better):
    effects = camera | {"gain_shading": 0.3}
    result, sim = run(**effects)
    even, _ = run("physics.sensor.gain.type=column+row+pixel", **effects)
    assert strength(result) > 0
    assert psnr(result, sim) > psnr(even, sim) + better


def test_a_gain_that_falls_to_half_in_the_corners_is_found():
    result, sim = run(gain_shading=0.8, n_frames=8, **COUNTS)
    assert strength(result) > 0.08
    assert psnr(result, sim) > 48


def test_a_drift_goes_on_where_rows_jump():
    result, sim = run(gain_shading=0.4, level_drift=0.03, row_noise=0.002, n_frames=8, **COUNTS)
    assert strength(result) > 0
    assert "drifts" in " ".join(result.messages)
    assert psnr(result, sim) > 45


@pytest.mark.parametrize(
    "effects",
    [
        TONES,
        TONES | {"shading": 0.25},
        TONES | {"gain_column": 0.1},
        COUNTS | {"shading": 0.25},
        COUNTS | {"level_drift": 0.02},
    ],
)
def test_what_else_is_smooth_is_not_taken_for_it(effects):
    result, _ = run(**effects)
    assert strength(result) == 0


def test_three_frames_are_not_asked():
    result, _ = run(n_frames=3, gain_shading=0.3, **TONES)
    assert strength(result) == 0


def test_a_strength_that_is_given_is_kept():
    result, _ = run("physics.sensor.gain.shading.sigma=0.03", "solver.max_iterations=2", **TONES)
    assert strength(result) == 0.03
