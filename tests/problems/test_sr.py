"""Super-resolution: its physics, its recipe, and what it says of bursts that are not made for it."""

from functools import partial

import numpy as np
import pytest
import torch
from scipy.interpolate import BSpline
from small_problems import whole

import deepir
from deepir.assembly import build
from deepir.config import load
from deepir.errors import ConfigError, DataError
from deepir.metrics import scores
from deepir.operators import Downsample, Warp
from deepir.operators.warp import rescale_motion
from deepir.problems.sr import few_frames
from deepir.simulate import Settings, simulate

QUICK = {"threads": 1, "solver": {"max_iterations": 2}}


def camera(**more):
    settings = {
        "n_frames": 6, "shape": (32, 40), "factor": 2, "max_shift": 4.0, "motion": "shift", "gain_column": 0.1,
        "offset_column": 0.02, "offset_row": 0.0, "shading": 0.0, "dead_pixels": 0.0, "psf_sigma": 0.0,
    }  # fmt: skip
    return simulate(None, Settings(**settings | more), seed=1)


@pytest.fixture(scope="module")
def sim():
    """Six frames of 32 x 40 px, with a truth twice as fine."""
    return camera()


def at_motion(motion, size, factor):
    """Integration behind a warp, for frames of `size` that see the middle of their canvas."""
    fine = tuple(int(each) for each in np.multiply(factor, size))
    canvas, origin = (fine[0] + 40, fine[1] + 40), (20, 20)
    return (
        Downsample(factor=factor) @ Warp(fine, canvas, origin),
        canvas,
        {"warp.motion": rescale_motion(motion, factor)},
    )


# ---- physics ----


@pytest.mark.parametrize("factor", [1, 2, 3, 4, 8, (3, 2)])
def test_a_shifted_pixel_is_the_exact_integral_of_the_scene_over_its_area(factor):
    """The scene is the quadratic spline; a detector's pixel is `factor` of its px wide, wherever it falls."""
    motion = torch.eye(3, dtype=torch.float64)[None].clone()
    motion[0, :2, 2] = torch.tensor([0.37, -1.21])  # detector px
    size = (5, 6)
    operator, canvas, slots = at_motion(motion, size, factor)
    coefficients = torch.rand(1, 1, *canvas, dtype=torch.float64)
    found = operator(coefficients, **slots)[0, 0].numpy()

    spline = BSpline.basis_element([-1.5, -0.5, 0.5, 1.5], extrapolate=False)

    def integrals(count, side, shift, factor):
        rows = np.zeros((count, side))
        for i in range(count):
            centre = factor * (i - (count - 1) / 2 + shift) + (side - 1) / 2
            for j in range(side):
                low, high = (np.clip(centre + way * factor / 2 - j, -1.5, 1.5) for way in (-1, 1))
                rows[i, j] = spline.integrate(low, high) / factor
        return rows

    down, across = map(integrals, size, canvas, (-1.21, 0.37), np.broadcast_to(factor, 2))
    np.testing.assert_allclose(found, down @ coefficients[0, 0].numpy() @ across.T, atol=1e-12)


@pytest.mark.parametrize("factor", [2, 4, 7])
def test_a_motion_registered_on_the_detector_is_the_same_on_the_scenes_grid(factor):
    """A ramp of the scene: what a detector's pixel sees is the ramp where its centre looks."""
    motion = torch.tensor([[[0.98, -0.2, 1.3], [0.2, 1.01, -0.7], [0, 0, 1]]], dtype=torch.float64)
    size = (6, 8)
    operator, canvas, slots = at_motion(motion, size, factor)
    y, x = (torch.arange(side, dtype=torch.float64) - (side - 1) / 2 for side in canvas)
    found = operator((0.3 * x - 0.2 * y[:, None])[None, None], **slots)[0, 0]
    v, u = (torch.arange(side, dtype=torch.float64) - (side - 1) / 2 for side in size)
    points = torch.stack([u.expand(size), v[:, None].expand(size), torch.ones(size)], -1) @ motion[0].T
    expected = factor * (0.3 * points[..., 0] - 0.2 * points[..., 1])
    assert torch.allclose(found, expected, atol=1e-9)


def test_with_factor_one_the_model_is_that_of_nuc():
    frames = np.random.default_rng(0).random((3, 24, 32)).astype(np.float32)
    burst = whole(frames)
    motion = torch.eye(3, dtype=torch.float64).repeat(3, 1, 1)
    motion[1:, :2, 2] = torch.tensor([[2.3, -1.0], [-1.5, 3.2]])
    (sr, at), (nuc, window) = (
        build(load(name, changes), burst, motion)
        for name, changes in (("sr", ["physics.downsample.factor=1"]), ("nuc", []))
    )
    assert (at.ratio, at.window) == ((1, 1), window.window)
    values = nuc.values()
    values["scene"] = torch.rand_like(values["scene"])
    assert torch.equal(sr.predict(values), nuc.predict(values))
    assert torch.equal(sr.precision, nuc.precision)


def test_a_known_blur_goes_between_motion_and_integration(sim):
    changes = ["physics.blur.before=downsample", "physics.blur.psf={type: gaussian, sigma: 1.0}"]
    result = deepir.run("sr", "physics.downsample.factor=2", *changes, frames=sim.frames, **QUICK)
    assert result.scene.shape == (64, 80)


# ---- the result ----


def compared(frames, factor, truth):
    """The result of the joint solve, and PSNR of it and of simpler methods."""
    run = partial(deepir.run, "sr", f"physics.downsample.factor={factor}", frames=frames, threads=1)
    found = {each: run(f"method={each}") for each in ("bicubic", "average", "joint")}
    return found["joint"], {each: scores(result.scene, truth)["psnr_aligned"] for each, result in found.items()}


def test_the_scene_is_finer_and_better_than_what_interpolation_gives(sim):
    result, psnr = compared(sim.frames, 2, sim.truth.scene)
    assert psnr["average"] > psnr["bicubic"] + 1
    assert psnr["joint"] > psnr["average"] + 3
    assert result.scene.shape == (64, 80)
    assert result.gain.shape == result.offset.shape == (32, 40)
    level = sim.truth.scene.mean()  # where gain and offset can hardly be separated, but their sum is known
    pattern, true = (each.gain * level + each.offset for each in (result, sim.truth))
    assert (pattern - true).std() < 0.2 * true.std()
    motion = rescale_motion(torch.from_numpy(result.motion), 0.5).numpy()  # detector px
    assert np.abs(motion - sim.truth.motion)[:, :2, 2].max() < 0.15
    assert result.messages == []


def test_pixels_twice_as_high_as_wide_show_a_scene_of_square_ones():
    sim = camera(factor=1, gain_column=0.0)
    frames = Downsample(factor=(2, 1))(torch.from_numpy(sim.frames)[:, None])[:, 0].numpy()
    result, psnr = compared(frames, [2, 1], sim.truth.scene)
    assert result.scene.shape == (32, 40)
    assert psnr["joint"] > psnr["average"] + 3 > psnr["bicubic"] + 3
    assert np.abs(result.motion - sim.truth.motion)[:, :2, 2].max() < 0.15


def test_the_truth_is_compared_on_the_fine_grid(sim, tmp_path):
    _, truth = sim.save(tmp_path / "burst.npz")
    crop = "data.crop=[4,30,2,38]"
    data = [f"data.path={tmp_path / 'burst.npz'}", f"data.truth={truth}", "physics.downsample.factor=2"]
    whole, part = (deepir.run("sr", *data, *more, method="bicubic", threads=1) for more in ((), (crop,)))
    assert part.scene.shape == (52, 72)
    assert part.metrics["psnr_aligned"] == pytest.approx(whole.metrics["psnr_aligned"], abs=3)


def test_interpolated_pictures_of_a_ramp_are_the_ramp():
    y, x = np.mgrid[:32, :40].astype(np.float32)
    frames = np.stack([x + 2 * y, x + 2 * y])
    found = deepir.run("sr", "physics.downsample.factor=2", frames=frames, method="bicubic").scene
    fine_y, fine_x = (np.arange(64) - 0.5)[:, None] / 2, (np.arange(80) - 0.5) / 2
    np.testing.assert_allclose(found[8:-8, 8:-8], (fine_x + 2 * fine_y)[8:-8, 8:-8], atol=1e-2)


def test_frames_of_eight_bits_are_as_good_as_their_rounding(sim):
    low, high = sim.frames.min(), sim.frames.max()
    bytes8 = np.round(30 + 190 * (sim.frames - low) / (high - low)).astype(np.uint8)
    found = [
        deepir.run("sr", "physics.downsample.factor=2", frames=each, threads=1)
        for each in (bytes8, bytes8.astype(np.uint16))
    ]
    eight, sixteen = (scores(each.scene, sim.truth.scene)["psnr_aligned"] for each in found)
    assert eight > sixteen - 1.5
    assert not any("automatic gain" in message for message in found[0].messages)


# ---- what it says ----


def test_fewer_frames_than_the_factor_can_use_are_warned_of(sim):
    result = deepir.run("sr", "physics.downsample.factor=4", frames=sim.frames, **QUICK)
    message = next(each for each in result.messages if "for factor 4" in each)
    assert message.startswith("6 frames for factor 4: the scene has 16 px for each of the detector's")
    assert message.endswith("Take 16 frames, or physics.downsample.factor=2")
    assert few_frames(16, (4, 4)) == []
    assert few_frames(3, (2, 2))[0].endswith("Take 4 frames")  # no factor below 2 is one


@pytest.mark.parametrize("factor", [0, 9])
def test_a_factor_out_of_range_is_refused(sim, factor):
    with pytest.raises(ConfigError, match=rf"^physics.downsample: factor must be 1 to 8, not {factor}$"):
        deepir.run("sr", f"physics.downsample.factor={factor}", frames=sim.frames)


def test_frames_that_are_too_small_are_refused():
    with pytest.raises(DataError, match="12 x 14 px is too small"):
        deepir.run("sr", frames=np.random.default_rng(0).random((4, 12, 14)))


def test_a_stage_that_is_missing_is_named(sim):
    with pytest.raises(ConfigError, match="'sr' needs a stage 'downsample'"):
        deepir.run("sr", "physics.downsample=null", frames=sim.frames)
