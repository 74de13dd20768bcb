"""The method `recording`: what `deepir correct` estimates, for runs, comparisons and batches."""

import numpy as np
import pytest

import deepir

METHOD = "method=recording"


def test_a_run_is_what_correct_finds_with_a_report_and_lost_samples_do_not_count(walk, tmp_path, estimated_once):
    frames = walk.frames[::4].astype(np.float32)
    frames[3:6, 40:60, 50:80] = np.nan
    result = deepir.run("recording", METHOD, f"output.dir={tmp_path / 'run'}", frames=frames)
    corrected = deepir.correct(frames)
    assert np.array_equal(result.gain, corrected.maps.gain.astype(np.float32))
    assert np.array_equal(result.offset, corrected.maps.offset.astype(np.float32))
    assert np.array_equal(result.scene, corrected.frames, equal_nan=True)
    assert result.metrics["correction"] == corrected.estimate.kept
    assert (tmp_path / "run" / "report.html").exists()
    assert not result.bad_pixels[40:60, 50:80].all()
    level = 8450  # of the frames: there the pattern is known best
    found = result.offset + (result.gain - 1) * level
    true = walk.fine + walk.slow + (walk.gain - 1) * (level - 8000)
    assert np.corrcoef(found[~walk.bad], true[~walk.bad])[0, 1] > 0.99


@pytest.mark.parametrize("wrong", ["method.correction=offset", "method.gain=1"])
def test_a_wrong_choice_is_refused(walk, wrong):
    with pytest.raises(deepir.DeepIRError, match=r"allowed|unknown"):
        deepir.run("recording", METHOD, wrong, frames=walk.frames[:5])
