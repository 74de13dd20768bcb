"""Bad pixels and moving things are detected by what they do beside the model."""

import numpy as np
import pytest
import torch

import deepir
from deepir.arrays.samples import pattern_outliers
from deepir.effects.bad_pixels import (
    STATIC_PROBABILITY,
    dead_pixels,
    misfitting_pixels,
    neighbourhood_doubt,
    overlay_mask,
    region_message,
    static_pixels,
    still_region,
    with_scene_error,
)
from deepir.simulate import Settings, simulate
from tests.effects.solved import PLAIN, burst, psnr, solved

KNOWN = torch.ones(1, 1, 40, 50, dtype=torch.bool)


def pattern(sigma=3.0):
    torch.manual_seed(0)
    return sigma * torch.randn(1, 1, 40, 50) + 20 * torch.randn(1, 1, 1, 50) + 20 * torch.randn(1, 1, 40, 1)


def test_a_pixel_far_from_its_neighbours_is_found_under_strong_columns_and_rows():
    bad, known = pattern()[0, 0].numpy(), KNOWN[0, 0].numpy()
    bad[5, 6], bad[20, 30] = 400.0, -300.0
    found = pattern_outliers(bad, known)
    assert found[5, 6]
    assert found[20, 30]
    assert found.sum() == 2


@pytest.mark.parametrize("share", [0.0, 0.5])
def test_what_is_exactly_alike_is_no_outlier(share):
    alike = pattern()[0, 0].numpy()
    alike[:, int(50 * share) :] = 0
    assert not pattern_outliers(alike, KNOWN[0, 0].numpy()).any()


def test_dead_lines_and_blocks_are_found_live_pixels_that_hardly_change_are_not():
    frames, usable = 8000 + pattern() + 3 * torch.randn(6, 1, 40, 50), torch.ones(6, 1, 40, 50) > 0
    frames[..., 7], frames[:, :, 21], frames[:, :, 30:36, 30:36] = 50.0, 16383.0, 0.0
    found = dead_pixels(static_pixels(frames, usable, 3.0), frames.mean(0, keepdim=True) - 8000, KNOWN)
    expected = torch.zeros_like(found)
    expected[..., 7] = expected[:, :, 21] = expected[:, :, 30:36, 30:36] = True
    assert torch.equal(found, expected)


def test_what_is_saturated_as_the_scene_is_lives():
    frames, usable = 8000 + pattern() + 3 * torch.randn(6, 1, 40, 50), torch.ones(6, 1, 40, 50) > 0
    frames[:, :, :20] = 16383.0
    left = frames.mean(0, keepdim=True) - torch.where(torch.arange(40)[:, None] < 20, 16383.0, 8000.0)
    assert not dead_pixels(static_pixels(frames, usable, 3.0), left, KNOWN).any()


def moving():
    """Frames of a scene that moves two pixels from one to the next, plain at its right."""
    torch.manual_seed(0)
    scene = 100 + 40 * torch.randn(1, 40, 80)
    scene[..., 40:] = 120.0
    return torch.stack([scene[..., 2 * k : 2 * k + 50] for k in range(6)])


def test_a_box_drawn_over_moving_pictures_is_found_to_its_middle_that_expects_itself():
    expected, usable = moving(), torch.ones(6, 1, 40, 50) > 0
    frames = expected + torch.randn(6, 1, 40, 50)
    box = torch.zeros(1, 1, 40, 50, dtype=torch.bool)
    box[..., 5:15, 3:24] = True
    frames[:, 0, box[0, 0]] = 50.0
    expected[..., 8:12, 6:20] = 50.0
    assert torch.equal(overlay_mask(static_pixels(frames, usable, 1.0), expected, usable, 1.0), box)


def test_a_bonnet_that_shows_noise_before_a_scene_that_moves_is_given_up():
    expected, usable = moving(), torch.ones(6, 1, 40, 50) > 0
    frames = expected + torch.randn(6, 1, 40, 50)
    frames[..., 28:, :] = frames[:1, :, 28:] + torch.randn(6, 1, 12, 50)
    found = still_region(static_pixels(frames, usable, 1.5, STATIC_PROBABILITY), expected, usable, 1.5)
    assert found[..., 29:, :38].float().mean() > 0.95
    assert not found[..., :27, :].any()
    assert "between rows 2" in region_message(found)[0]


def test_a_plain_sky_without_noise_lives_though_a_ghost_is_expected_in_it():
    expected, usable = moving(), torch.ones(6, 1, 40, 50) > 0
    frames = expected.clone()
    expected[2, 0, 10:14, 44:46] = 160.0
    found = overlay_mask(static_pixels(frames, usable, 1.0), expected, usable, 1.0)
    assert found.sum() == 8


def test_a_scale_drawn_over_pictures_of_eight_bits_costs_nothing_but_its_place():
    frames = burst(5, n_frames=6, shape=(64, 80), counts=False).frames
    frames = np.round(255 * (frames - frames.min()) / np.ptp(frames))
    drawn, hidden = frames.copy(), np.zeros((64, 80), bool)
    hidden[8:-8, -7:-3] = True
    drawn[:, hidden] = np.linspace(250, 5, 48).round().repeat(4)
    frames[:, hidden] = np.nan
    cut, found = (deepir.run("nuc", frames=each, threads=1) for each in (frames, drawn))
    assert found.bad_pixels[hidden].all()
    apart = np.abs(found.scene - cut.scene)[:, :-14]
    assert np.median(apart) < 0.2


def test_a_burst_with_dead_columns_and_a_dead_block_is_as_good_as_without():
    sim = burst(5, shape=(64, 80))
    frames = sim.frames.copy()
    frames[:, :, [20, 21, 60]], frames[:, 30:36, 40:46] = 57, 0
    errors = [deepir.run("nuc", frames=each, threads=1).scene - sim.truth.scene for each in (sim.frames, frames)]
    whole, holed = (np.abs(error - np.median(error)).mean() for error in errors)
    assert holed < 1.3 * whole


def test_a_pixel_that_misfits_in_all_frames_is_given_up_one_that_does_so_once_is_not():
    misfit = torch.ones(4, 1, 40, 50)
    misfit[:, 0, 3, 4] = 60.0
    misfit[1, 0, 8, 9] = 40.0
    found = misfitting_pixels(misfit, torch.ones_like(misfit) > 0)
    assert found.nonzero()[:, 2:].tolist() == [[3, 4]]


def test_what_misfits_at_the_edge_of_a_lamp_that_is_displaced_is_no_defect():
    lamps = torch.rand(6, 1, 40, 50, generator=torch.Generator().manual_seed(0)) < 0.01
    lamps[..., -1] = False
    scene, usable = 500.0 * lamps, torch.ones_like(lamps)
    error = 0.03 * (scene.roll(1, -1) - scene)
    error[:, 0, 30, 30] = 100.0
    assert misfitting_pixels(error.square(), usable).sum() > 20
    found = misfitting_pixels(with_scene_error(error.square(), scene, usable, 1.0), usable)
    assert found.nonzero()[:, 2:].tolist() == [[30, 30]]


def test_a_region_that_misfits_is_no_defect_but_is_doubted():
    misfit = torch.ones(4, 1, 40, 50)
    misfit[2, 0, 10:20, 10:20] = 9.0
    usable = torch.ones_like(misfit) > 0
    assert not misfitting_pixels(misfit, usable).any()
    doubt = neighbourhood_doubt(misfit, usable)
    assert (doubt[2, 0, 12:18, 12:18] > 5).all()
    assert not doubt[0].any()


def test_dead_and_flickering_pixels_of_a_burst_are_found_and_filled():
    result, sim = solved(seed=5, n_frames=6, dead_pixels=0.005)
    truth, found = sim.truth.bad_pixels, result.bad_pixels
    assert (found & truth).sum() >= 0.9 * truth.sum()
    assert (found & ~truth).sum() <= 0.002 * truth.size
    error = np.abs(result.scene - sim.truth.scene - (result.scene - sim.truth.scene).mean())
    assert np.median(error[truth]) < 0.05 * sim.settings.contrast


def test_a_plain_scene_in_coarse_steps_has_no_dead_pixels():
    sim = burst(5, shape=(64, 80), contrast=600)
    steps = [deepir.run("nuc", frames=sim.frames // step * step, threads=1) for step in (1, 64)]
    fine, coarse = (np.abs(each.scene - np.median(each.scene - sim.truth.scene) - sim.truth.scene) for each in steps)
    assert steps[1].bad_pixels.mean() < 0.002
    assert np.median(coarse) < 20
    assert np.median(fine) < np.median(coarse)


def test_a_logo_before_a_plain_scene_does_not_keep_the_frames_at_rest():
    rng, (y, x) = np.random.default_rng(19), np.mgrid[:480, :640]
    scene = np.zeros((480, 640))
    for _ in range(14):
        width, height = rng.uniform(8, 40), rng.uniform(0.1, 0.6)
        off = (x - rng.uniform(0, 640)) ** 2 + (y - rng.uniform(0, 480)) ** 2
        scene += height * np.exp(-off / 2 / width**2)
    camera = Settings(n_frames=5, shape=(96, 128), shading=0.0, dead_pixels=0.0, max_shift=4.0)
    sim = simulate((scene - scene.min()) / np.ptp(scene), camera, seed=5)
    frames = np.round(60 + 120 * (sim.frames - sim.frames.min()) / np.ptp(sim.frames))
    frames[:, ((x[:96, :128] - 65) / 26) ** 2 + ((y[:96, :128] - 48) / 20) ** 2 < 1] = 20
    frames[:, 40:56, 50:80:4] = 250
    result = deepir.run("nuc", frames=frames, threads=1)
    assert np.abs(result.motion - sim.truth.motion).max() < 0.3


def spots(seed, shape=(300, 380)):
    """A dark scene with lamps of a pixel and more, one as bright as all the range."""
    rng = np.random.default_rng(seed)
    y, x = np.ogrid[: shape[0], : shape[1]]
    scene = np.full(shape, 0.05)
    for brightness in rng.pareto(1.2, 120) * 0.05:
        at, width = rng.uniform(0, shape), rng.choice([1.2, 1.5, 2.0, 3.0])
        scene += brightness * np.exp(-((y - at[0]) ** 2 + (x - at[1]) ** 2) / (2 * width**2))
    return scene.clip(0, 1)


@pytest.mark.parametrize("seed", [5, pytest.param(7, marks=pytest.mark.slow)])
def test_lamps_in_the_dark_are_seen_as_they_are(seed):
    tones = {"shape": (96, 128), "counts": False, "photons": 1000.0, "read_noise": 0.002}
    lines = {"gain_column": 0.1, "gain_pixel": 0.02, "offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0}
    sim = simulate(spots(seed), Settings(**PLAIN | tones | lines), seed=seed)
    result = deepir.run("nuc", frames=sim.frames, threads=1)
    assert psnr(result, sim) > 53
    assert result.bad_pixels.sum() <= 3
