"""The learned super-resolution of single frames. The pictures are none that it has learnt from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.transform import resize

import deepir
from deepir.baselines.single_frame.bicubic import enlarge
from deepir.baselines.single_frame.vdsr import sharpen
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture

CLEAN = {
    "gain_pixel": 0.0, "gain_column": 0.0, "offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0,
    "shading": 0.0, "dead_pixels": 0.0, "psf_sigma": 0.0,
}  # fmt: skip


def gained(name, factor):
    """PSNR above that of bicubic, of a picture as a detector's pixels see it."""
    fine = resize(load_picture(name), (96, 120), anti_aliasing=True)
    pixels = fine.reshape(96 // factor, factor, 120 // factor, factor).mean((1, 3))
    enlarged_only = enlarge(pixels, factor)
    return scores(sharpen(enlarged_only), fine)["psnr_aligned"] - scores(enlarged_only, fine)["psnr_aligned"]


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_one_network_is_better_than_bicubic_at_each_factor_on_fresh_pictures(factor):
    assert min(gained(name, factor) for name in ("camera", "astronaut")) > 0.3


def test_sharpened_frames_are_better_averaged_than_as_they_are_and_than_one():
    sim = simulate(load_picture("camera"), Settings(n_frames=8, shape=(48, 64), factor=2, **CLEAN), seed=3)
    psnr = {
        method: scores(
            deepir.run("sr", "physics.downsample.factor=2", frames=sim.frames, method=method).scene,
            sim.truth.scene,
        )["psnr_aligned"]
        for method in ("bicubic", "average", "vdsr")
    }
    assert psnr["vdsr"] > psnr["average"] + 0.3
    assert psnr["vdsr"] > psnr["bicubic"] + 1


@settings(max_examples=5, deadline=None)
@given(
    gain=st.floats(1e-2, 1e4), level=st.floats(-10, 10), height=st.integers(3, 40), width=st.integers(3, 40)
)
def test_it_knows_no_units_and_any_size_will_do(gain, level, height, width):
    frame = np.random.default_rng(height).random((height, width))
    assert np.allclose(sharpen(gain * (frame + level)) / gain - level, sharpen(frame), atol=1e-4)
