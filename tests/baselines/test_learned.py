"""The learned destriper of columns and super-resolution of single frames, on pictures that neither learnt from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.transform import resize

import deepir
from deepir.baselines.single_frame.bicubic import enlarge
from deepir.baselines.single_frame.destripe_cnn import destripe
from deepir.baselines.single_frame.vdsr import sharpen
from deepir.metrics import scores
from deepir.simulate import Settings, simulate
from deepir.simulate.scenes.procedural import load_picture, procedural

CLEAN = {
    "gain_pixel": 0.0, "gain_column": 0.0, "offset_pixel": 0.0, "offset_column": 0.0, "offset_row": 0.0,
    "shading": 0.0, "dead_pixels": 0.0, "psf_sigma": 0.0,
}  # fmt: skip


def scene(name="camera"):
    return resize(load_picture(name), (96, 128), anti_aliasing=True)


def striped(clean, gain=0.15, offset=0.02):
    gains, offsets = np.random.default_rng(0).standard_normal((2, clean.shape[1]))
    return clean * (1 + gain * gains) + offset * offsets


@pytest.mark.parametrize("name", ["camera", "moon", "astronaut", "drawing"])
def test_columns_are_taken_out_of_a_fresh_picture_by_five_decibels_at_least(name):
    clean = procedural(1, (96, 128)) if name == "drawing" else scene(name)
    before, after = (
        scores(each, clean)["psnr_aligned"] for each in (striped(clean), destripe(striped(clean)))
    )
    assert after > before + 5


def test_stripes_on_a_flat_field_are_found_within_a_fifth():
    stripes = striped(np.zeros((96, 128)))
    assert (destripe(stripes) - stripes.mean())[:, 4:-4].std() < 0.2 * stripes.std()


def test_stripes_along_rows_are_kept():
    # The same stripes turned: nothing says that they are the sensor's.
    rows = striped(scene().T).T - scene()
    left = destripe(scene() + rows) - destripe(scene())
    assert np.corrcoef(left.ravel(), rows.ravel())[0, 1] > 0.95


def test_the_level_stays():
    frame = 8000 + 1500 * striped(scene())
    assert destripe(frame).mean() == pytest.approx(frame.mean(), rel=1e-6)


def gained(name, factor):
    """PSNR above that of bicubic, of a picture as a detector's pixels see it."""
    fine = resize(load_picture(name), (96, 120), anti_aliasing=True)
    pixels = fine.reshape(96 // factor, factor, 120 // factor, factor).mean((1, 3))
    enlarged_only = enlarge(pixels, factor)
    return scores(sharpen(enlarged_only), fine)["psnr_aligned"] - scores(enlarged_only, fine)["psnr_aligned"]


@pytest.mark.parametrize("factor", [2, 3, 4])
def test_one_network_is_better_than_bicubic_at_each_factor_on_fresh_pictures(factor):
    assert min(gained(name, factor) for name in ("camera", "astronaut")) > 0.3


def test_sharpened_frames_are_better_averaged_and_many_frames_show_more_than_one():
    sim = simulate(load_picture("camera"), Settings(n_frames=8, shape=(48, 64), factor=2, **CLEAN), seed=3)
    psnr = {
        method: scores(
            deepir.run("sr", "physics.downsample.factor=2", frames=sim.frames, method=method).scene,
            sim.truth.scene,
        )["psnr_aligned"]
        for method in ("bicubic", "average", "vdsr", "shift_and_add")
    }
    assert psnr["vdsr"] > psnr["average"] + 0.3
    assert psnr["vdsr"] > psnr["bicubic"] + 1
    assert psnr["shift_and_add"] > psnr["bicubic"] + 0.5


@pytest.mark.parametrize("network", [destripe, sharpen])
@settings(max_examples=5, deadline=None)
@given(
    gain=st.floats(1e-2, 1e4), level=st.floats(-10, 10), height=st.integers(9, 40), width=st.integers(9, 40)
)
def test_units_and_size_are_free(network, gain, level, height, width):
    frame = np.random.default_rng(height).random((height, width))
    assert np.allclose(network(gain * (frame + level)) / gain - level, network(frame), atol=1e-4)
