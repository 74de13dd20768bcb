"""The method `recording`: what `deepir correct` estimates, for runs, comparisons and batches."""

import numpy as np
import pytest

import deepir

METHOD = "method=recording"


def test_a_run_has_the_maps_and_frames_of_correct_and_a_report(walk, tmp_path):
    frames = walk.frames[::4].astype(np.float32)
    result = deepir.run("recording", METHOD, f"output.dir={tmp_path / 'run'}", frames=frames)
    corrected = deepir.correct(frames)
    assert np.array_equal(result.gain, corrected.maps.gain.astype(np.float32))
    assert np.array_equal(result.offset, corrected.maps.offset.astype(np.float32))
    assert np.array_equal(result.scene, corrected.frames)
    assert result.metrics["correction"] == corrected.estimate.kept
    assert (tmp_path / "run" / "report.html").exists()


def test_lost_samples_do_not_count(walk):
    frames = walk.frames[::4].astype(np.float32)
    frames[3:6, 40:60, 50:80] = np.nan
    result = deepir.run("recording", METHOD, frames=frames)
    assert not result.bad_pixels[40:60, 50:80].all()
    assert np.corrcoef(result.offset[~walk.bad], (walk.fine + walk.slow)[~walk.bad])[0, 1] > 0.9


def test_a_gain_control_scales_the_pattern_of_each_frame(walk):
    contrast = np.linspace(0.04, 0.06, 60)[:, None, None]
    frames = (128 + contrast * (walk.frames[::2] - 8600.0)).clip(0, 255).astype(np.uint8)
    corrected = deepir.correct(frames)
    numbers, gains = corrected.estimate.contrasts
    true = contrast.ravel()[numbers]
    assert np.allclose(gains / gains.mean(), true / true.mean(), atol=0.05)


@pytest.mark.parametrize("wrong", ["method.correction=offset", "method.gain=1"])
def test_a_wrong_choice_is_refused(walk, wrong):
    with pytest.raises(deepir.DeepIRError, match=r"allowed|unknown"):
        deepir.run("recording", METHOD, wrong, frames=walk.frames[:5])
