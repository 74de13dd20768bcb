"""The learned destriper of columns. The pictures are none that it has learnt from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from skimage.transform import resize

from deepir.baselines.single_frame.destripe_cnn import destripe
from deepir.metrics import scores
from deepir.simulate.scenes.procedural import load_picture, procedural


def scene(name="camera"):
    return resize(load_picture(name), (96, 128), anti_aliasing=True)


def striped(clean, gain=0.15, offset=0.02):
    gains, offsets = np.random.default_rng(0).standard_normal((2, clean.shape[1]))
    return clean * (1 + gain * gains) + offset * offsets


@pytest.mark.parametrize("name", ["camera", "moon", "astronaut"])
def test_columns_are_taken_out_of_a_fresh_photograph_by_five_decibels_at_least(name):
    before, after = (
        scores(each, scene(name))["psnr_aligned"]
        for each in (striped(scene(name)), destripe(striped(scene(name))))
    )
    assert after > before + 5


def test_columns_are_taken_out_of_a_fresh_drawing_by_five_decibels_at_least():
    clean = procedural(1, (96, 128))
    before, after = (
        scores(each, clean)["psnr_aligned"] for each in (striped(clean), destripe(striped(clean)))
    )
    assert after > before + 5


def test_stripes_on_a_flat_field_are_found_within_a_fifth():
    stripes = striped(np.zeros((96, 128)))
    assert (destripe(stripes) - stripes.mean())[:, 4:-4].std() < 0.2 * stripes.std()


def test_rows_are_the_scenes():
    # The same stripes turned: nothing says that they are the sensor's.
    rows = striped(scene().T).T - scene()
    left = destripe(scene() + rows) - destripe(scene())
    assert np.corrcoef(left.ravel(), rows.ravel())[0, 1] > 0.95


@settings(max_examples=5, deadline=None)
@given(
    gain=st.floats(1e-2, 1e4), level=st.floats(-10, 10), height=st.integers(9, 40), width=st.integers(9, 40)
)
def test_it_knows_no_units_and_any_size_will_do(gain, level, height, width):
    frame = np.random.default_rng(height).random((height, width))
    assert np.allclose(destripe(gain * (frame + level)) / gain - level, destripe(frame), atol=1e-4)


def test_the_level_stays():
    frame = 8000 + 1500 * striped(scene())
    assert destripe(frame).mean() == pytest.approx(frame.mean(), rel=1e-6)
