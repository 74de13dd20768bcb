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


def test_the_correction_is_chosen_in_yaml(walk):
    result = deepir.run("recording", METHOD, "method.correction=fine_offset", frames=walk.frames[::4])
    assert result.metrics["correction"] == "fine_offset"
    assert (result.gain == 1).all()


def test_lost_samples_do_not_count(walk):
    frames = walk.frames[::4].astype(np.float32)
    frames[3:6, 40:60, 50:80] = np.nan
    result = deepir.run("recording", METHOD, frames=frames)
    assert not result.bad_pixels[40:60, 50:80].all()
    assert np.corrcoef(result.offset[~walk.bad], (walk.fine + walk.slow)[~walk.bad])[0, 1] > 0.9


def test_pictures_have_a_strength_of_the_pattern_each_as_in_correct(walk):
    contrast = np.linspace(0.03, 0.07, 30)[:, None, None]
    frames = (128 + contrast * (walk.frames[::4] - 8600.0)).clip(0, 255).astype(np.uint8)
    result, corrected = deepir.run("recording", METHOD, frames=frames), deepir.correct(frames)
    assert corrected.estimate.strength is not None
    assert np.corrcoef(result.offset[~walk.bad], corrected.maps.offset[~walk.bad])[0, 1] > 0.99


@pytest.mark.parametrize("wrong", ["method.correction=nix", "method.gain=1"])
def test_a_wrong_choice_is_refused(walk, wrong):
    with pytest.raises(deepir.DeepIRError, match=r"allowed|unknown"):
        deepir.run("recording", METHOD, wrong, frames=walk.frames[:5])
