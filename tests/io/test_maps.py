import numpy as np
import pytest
import recordings
import tifffile
from PIL import Image

from deepir.errors import DataError
from deepir.io import read_mask, read_truth

SHAPE = (20, 24)


@pytest.fixture
def mask():
    mask = np.zeros(SHAPE, bool)
    mask[3, 4:9] = True
    return mask


@pytest.mark.parametrize(
    ("name", "save"),
    [
        ("mask.npz", lambda path, mask: np.savez(path, mask=mask)),
        ("mask.npy", np.save),
        ("mask.png", lambda path, mask: Image.fromarray(mask).save(path)),
        ("mask.tif", lambda path, mask: tifffile.imwrite(path, mask.astype(np.uint8) * 255)),
    ],
)
def test_masks_are_read_from_arrays_and_pictures(tmp_path, mask, name, save):
    save(tmp_path / name, mask)
    read = read_mask(tmp_path / name, SHAPE)
    assert read.dtype == bool
    np.testing.assert_array_equal(read, mask)


@pytest.mark.parametrize(
    ("read", "arrays", "shape", "message"),
    [
        (read_mask, {"mask": np.zeros(SHAPE)}, (24, 20), "the mask is 20 x 24 px, the frames are 24 x 20 px"),
        (read_mask, {"mask": np.ones(SHAPE)}, SHAPE, "ignores every pixel"),
        (read_truth, {"gain": np.ones(SHAPE)}, SHAPE, "needs an array `scene`; this has gain"),
        (read_truth, {"scene": np.ones(SHAPE)}, (40, 48), "the scene is 20 x 24 px, expected 40 x 48 px"),
    ],
)
def test_what_does_not_go_with_the_frames_is_refused(tmp_path, read, arrays, shape, message):
    np.savez(tmp_path / "a.npz", **arrays)
    with pytest.raises(DataError, match=message):
        read(tmp_path / "a.npz", shape)


def test_a_truncated_truth_is_refused(tmp_path, burst):
    recordings.cut(lambda path, frames: np.savez(path, scene=frames[0]), 40)(tmp_path / "t.npz", burst)
    with pytest.raises(DataError, match="damaged or truncated"):
        read_truth(tmp_path / "t.npz", SHAPE)


def test_anything_but_zero_is_ignored(tmp_path):
    values = np.zeros(SHAPE)
    values[0, :3] = [-1, 0.1, np.nan]
    np.save(tmp_path / "mask.npy", values)
    assert read_mask(tmp_path / "mask.npy", SHAPE).sum() == 3


def test_a_truth_has_a_scene_and_whatever_else_is_known(tmp_path):
    scene = np.arange(480.0).reshape(1, 1, *SHAPE)
    np.savez(tmp_path / "t.npz", scene=scene, gain=np.ones(SHAPE), motion=np.eye(3)[None], camera="A65")
    truth = read_truth(tmp_path / "t.npz", SHAPE)
    assert sorted(truth) == ["gain", "motion", "scene"]
    assert {array.dtype for array in truth.values()} == {np.dtype(np.float32)}
    np.testing.assert_array_equal(truth["scene"], scene[0, 0])


def test_each_frame_may_have_its_own_scene(tmp_path, burst):
    np.savez(tmp_path / "t.npz", scene=burst)
    assert read_truth(tmp_path / "t.npz", SHAPE)["scene"].shape == (3, *SHAPE)


def test_a_picture_is_a_truth_of_the_scene(tmp_path, burst):
    Image.fromarray(burst[0]).save(tmp_path / "t.png")
    truth = read_truth(tmp_path / "t.png", SHAPE)
    assert list(truth) == ["scene"]
    np.testing.assert_array_equal(truth["scene"], burst[0])
