"""Rows and columns that jump from frame to frame: found where they do, left alone where they do not."""

import numpy as np
import pytest
import torch

import deepir
from deepir.closed_form.normal_equations import sensor_least_squares
from deepir.errors import ConfigError
from deepir.fields.line_noise import ColumnNoise, RowNoise
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import procedural
from tests.effects.solved import PLAIN, burst, error, solved

READ_NOISE = 0.003  # of the range, of these bursts
NOISE = READ_NOISE * 1500  # counts
WITHOUT = "physics.sensor.level=drift"


@pytest.mark.parametrize(("lines", "truth"), [("row", "rows"), ("column", "columns")])
def test_lines_that_jump_are_found_and_taken_out(lines, truth):
    errors = []
    for seed in (5, 3):
        jumps = {"seed": seed, f"{lines}_noise": 2 * READ_NOISE}
        (result, sim), (without, _) = solved(**jumps), solved(WITHOUT, **jumps)
        errors.append((error(result, sim), error(without, sim)))
    found = result.metrics["strengths"]
    other = {"row": "column", "column": "row"}[lines]
    assert found[f"level.{lines}_noise.sigma"] == pytest.approx(2 * NOISE, rel=0.4)
    assert found[f"level.{other}_noise.sigma"] == 0
    assert np.mean([taken / left for taken, left in errors]) < 0.8
    assert any(message.startswith(f"{truth} jump by") for message in result.messages)
    # Level and noise of the frames are not taken for what the lines do.
    assert result.metrics["noise_sigma"] == pytest.approx(NOISE, rel=0.3)
    assert without.metrics["noise_sigma"] > 1.5 * NOISE


@pytest.mark.parametrize("effects", [{}, {"gain_row": 0.05, "offset_row": 0.05}, {"max_rotation": 4.0}])
def test_where_no_line_jumps_nothing_changes(effects):
    result, _ = solved(**effects)
    assert not any("jump" in message for message in result.messages)
    np.testing.assert_array_equal(result.scene, solved(WITHOUT, **effects)[0].scene)


@pytest.mark.parametrize(
    ("scene", "camera"),
    [
        (2, {"shape": (24, 32), "max_shift": 4.0, "offset_pixel": 0.04, "offset_row": 0.03}),
        (1, {"shape": (48, 64), "max_shift": 6.0, "n_frames": 8, "shading": 0.2}),
        pytest.param(4, {"shape": (48, 64), "max_shift": 6.0, "n_frames": 8, "shading": 0.2}, marks=pytest.mark.slow),
    ],
)
def test_edges_as_long_as_a_short_line_do_not_make_it_jump(scene, camera):
    for seed in range(2):
        sim = simulate(procedural(scene, (430, 500)), Settings(**PLAIN | camera), seed=seed)
        result = deepir.run("nuc", frames=sim.frames, threads=1)
        assert not any("jump" in message for message in result.messages)


def test_two_frames_leave_no_jump_to_be_seen():
    result, _ = solved(n_frames=2, row_noise=2 * READ_NOISE)
    assert result.metrics["strengths"]["level.row_noise.sigma"] == 0


def test_what_is_given_is_not_estimated():
    given, _ = solved("physics.sensor.level.row_noise.sigma=7.5", "solver.max_iterations=2", row_noise=2 * READ_NOISE)
    assert given.metrics["strengths"]["level.row_noise.sigma"] == 7.5
    with pytest.raises(ConfigError, match="sigma must be a number of at least 0"):
        solved("physics.sensor.level.row_noise.sigma=-1", row_noise=2 * READ_NOISE)


def test_jumps_of_rows_are_neither_a_drift_nor_a_shading():
    result, _ = solved(seed=3, row_noise=2 * READ_NOISE)
    found = result.metrics["strengths"]
    assert found["gain.shading.sigma"] == found["offset.shading.sigma"] == 0
    assert np.abs(result.level).max() < NOISE  # the mean of a frame's jumps, which is one, too
    assert not any("drifts" in message for message in result.messages)


def test_a_run_whose_rows_jump_and_level_drifts_repeats_to_the_bit():
    sim = burst(row_noise=2 * READ_NOISE, level_drift=0.3)
    first, second = (deepir.run("nuc", frames=sim.frames, threads=1) for _ in range(2))
    np.testing.assert_array_equal(first.scene, second.scene)


def test_a_simulated_line_jumps_as_the_truth_says():
    still, jumping = burst(counts=False), burst(counts=False, row_noise=0.1, column_noise=0.05)
    truth = jumping.truth
    np.testing.assert_allclose(jumping.frames - still.frames, truth.rows[..., None] + truth.columns[:, None], atol=1e-5)
    assert truth.rows.std() == pytest.approx(0.1, rel=0.1)
    assert truth.columns.std() == pytest.approx(0.05, rel=0.1)
    assert not still.truth.rows.any()
    assert not still.truth.columns.any()


def test_the_prior_is_gaussian_and_without_strength_there_is_one_value_a_frame():
    for kind, shape in ((RowNoise, (3, 1, 4, 1)), (ColumnNoise, (3, 1, 1, 5))):
        field = kind((3, 1, 1, 1), size=(4, 5), sigma=0.5)
        value = torch.randn(shape)
        field.init_from(value.expand(3, 1, 4, 5))
        torch.testing.assert_close(field.penalty().detach(), value.square().sum() / (2 * 0.25))
        asleep = kind((3, 1, 1, 1), size=(4, 5))
        assert asleep().shape == (3, 1, 1, 1)
        assert asleep.penalty() is None


@pytest.mark.parametrize("lines", [(4, 1), (1, 5), (4, 5)])
def test_the_gradient_in_levels_of_lines_is_that_of_autograd(lines):
    generator = torch.Generator().manual_seed(0)
    shape = (3, 1, 4, 5)
    flux, data, precision = (torch.rand(shape, generator=generator, dtype=torch.float64) for _ in range(3))
    gain, offset = (torch.rand((1, 1, 4, 5), generator=generator, dtype=torch.float64) for _ in range(2))
    level = torch.rand((3, 1, *lines), generator=generator, dtype=torch.float64, requires_grad=True)
    wanted = (precision * (gain * flux + offset + level - data).square()).sum() / 2
    found = sensor_least_squares(flux, data, precision, (gain, offset, level))
    torch.testing.assert_close(found.detach(), wanted.detach())
    slopes = [torch.autograd.grad(each, level)[0] for each in (found, wanted)]
    torch.testing.assert_close(*slopes)
