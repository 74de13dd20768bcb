import numpy as np
import pytest

from deepir.io import Frames, describe, read_frames


def burst_of(frames, dtype="uint16"):
    return Frames(np.asarray(frames, np.float32), "a", dtype, "")


def simulated(step, count=4, noise=6.0, contrast=200.0):
    """Frames of a smooth scene that moves `step` px right each frame, behind a fixed pattern, with noise."""
    rng = np.random.default_rng(4)
    y, x = np.mgrid[:128, :160]
    pattern = 20 * rng.standard_normal((128, 160))
    return np.stack(
        [
            8000
            + contrast * (np.sin((x - step * k) / 17) + np.cos((y + 0.3 * x - step * k) / 23))
            + pattern
            + noise * rng.standard_normal((128, 160))
            for k in range(count)
        ]
    )


def text(frames, dtype="uint16"):
    return "\n".join(describe(burst_of(frames, dtype)))


def number_after(words, content):
    return float(content.split(words)[1].split()[0])


def with_defects():
    frames = simulated(0)
    frames[1, 2, 3], frames[:, 5, 5:7], frames[0, 9, 9] = np.nan, 0, 2**14 - 1
    return frames


@pytest.mark.parametrize(
    ("frames", "lines"),
    [
        (
            with_defects(),
            [
                "4 frame(s) of 128 x 160 px (height x width), stored as uint16",
                "values 0 to 16383",
                "1 sample(s) are NaN",
                "2 pixel(s) are zero in every frame",
                "1 sample(s) are at full scale (16383)",
            ],
        ),
        (simulated(0, contrast=0), ["motion: none"]),
        (simulated(0, count=1).repeat(3, axis=0), ["temporal noise about 0 ", "motion: none"]),
        (np.ones((1, 20, 20)), ["too few or too small"]),
        (np.ones((3, 8, 20)), ["too few or too small"]),
        (np.full((2, 20, 20), np.nan), ["no finite value"]),
        # A camera of 9 Hz that is read at 27.
        (simulated(3).repeat(3, axis=0), ["8 frame(s) repeat the one before them; a run leaves", "motion: yes"]),
    ],
)
def test_what_frames_hold_is_said(frames, lines):
    said = text(frames)
    assert [line for line in lines if line not in said] == []


def test_kelvin_do_not_saturate():
    assert "full scale" not in text(with_defects(), "float32")


@pytest.mark.parametrize(("step", "words"), [(0, "about"), (1.5, "at most")])
def test_noise_is_right_with_and_without_motion(step, words):
    assert pytest.approx(6, rel=0.1) == number_after(  # infinite samples say nothing, nor warn
        f"temporal noise {words}", text(np.where(np.arange(160) == 4, np.inf, simulated(step)))
    )


@pytest.mark.parametrize(("step", "moves"), [(0, False), (0.02, False), (0.3, True), (1.5, True), (6, True)])
def test_motion_is_seen_and_a_still_camera_too(step, moves):
    assert ("motion: yes" in text(simulated(step))) == moves


def test_a_moving_and_a_still_real_camera_are_distinguished(data):
    moving = "\n".join(describe(read_frames(data / "a65" / "a65_frames_000-009.npz")))
    still = "\n".join(describe(read_frames(data / "lepton" / "lepton_tlinear_82x120x160.npz")))
    assert "motion: yes" in moving
    assert "motion: none" in still
    assert number_after("temporal noise at most", moving) == pytest.approx(6, abs=1)


def test_frames_that_show_nothing_are_named_and_are_no_noise():
    rng = np.random.default_rng(0)
    frames = 1000 + rng.normal(0, 2, (5, 32, 40)).astype(np.float32)
    whole, frames = text(frames), np.insert(frames, 2, 0, axis=0)
    said = text(frames)
    assert "frame 2 shows nothing: it is 0 everywhere" in said
    assert said.splitlines()[-2:] == whole.splitlines()[-2:]


@pytest.mark.parametrize("shape", [(1, 1, 1), (3, 1, 40), (3, 40, 1), (20, 2, 3), (4, 15, 17), (9, 40, 3)])
@pytest.mark.parametrize("lost", [0, 0.3, 1])
def test_frames_of_any_size_are_described(shape, lost):
    frames = np.random.default_rng(0).normal(8000, 20, shape)
    frames[np.random.default_rng(1).random(shape) < lost] = np.nan
    assert f"{shape[0]} frame(s) of {shape[1]} x {shape[2]} px" in text(frames)
