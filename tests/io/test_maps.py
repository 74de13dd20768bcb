import numpy as np
import pytest
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


def save_npz(path, mask):
    np.savez(path, mask=mask)


def save_png(path, mask):
    Image.fromarray(mask).save(path)


def save_tiff(path, mask):
    tifffile.imwrite(path, mask.astype(np.uint8) * 255)


@pytest.mark.parametrize("save", [save_npz, np.save, save_png, save_tiff])
def test_masks_are_read_from_arrays_and_pictures(tmp_path, mask, save):
    suffix = {np.save: ".npy", save_npz: ".npz", save_png: ".png", save_tiff: ".tif"}[save]
    save(tmp_path / f"mask{suffix}", mask)
    read = read_mask(tmp_path / f"mask{suffix}", SHAPE)
    assert read.dtype == bool
    np.testing.assert_array_equal(read, mask)


def test_anything_but_zero_is_ignored(tmp_path):
    values = np.zeros(SHAPE)
    values[0, :3] = [-1, 0.1, np.nan]
    np.save(tmp_path / "mask.npy", values)
    assert read_mask(tmp_path / "mask.npy", SHAPE).sum() == 3


def test_a_mask_of_another_shape_is_reported_with_both(tmp_path, mask):
    np.save(tmp_path / "mask.npy", mask)
    with pytest.raises(DataError, match="the mask is 20 x 24 px, the frames are 24 x 20 px"):
        read_mask(tmp_path / "mask.npy", (24, 20))


def test_a_mask_that_leaves_nothing_is_refused(tmp_path):
    np.save(tmp_path / "mask.npy", np.ones(SHAPE))
    with pytest.raises(DataError, match="ignores every pixel"):
        read_mask(tmp_path / "mask.npy", SHAPE)


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


def test_a_truth_without_a_scene_says_what_it_has(tmp_path):
    np.savez(tmp_path / "t.npz", gain=np.ones(SHAPE))
    with pytest.raises(DataError, match="needs an array `scene`; this has gain"):
        read_truth(tmp_path / "t.npz", SHAPE)


def test_a_truth_of_another_shape_is_reported_with_both(tmp_path, burst):
    np.savez(tmp_path / "t.npz", scene=burst[0])
    with pytest.raises(DataError, match="the scene is 20 x 24 px, expected 40 x 48 px"):
        read_truth(tmp_path / "t.npz", (40, 48))


def test_a_truncated_truth_is_refused(tmp_path, burst):
    np.savez(tmp_path / "t.npz", scene=burst[0])
    (tmp_path / "t.npz").write_bytes((tmp_path / "t.npz").read_bytes()[:-40])
    with pytest.raises(DataError, match="damaged or truncated"):
        read_truth(tmp_path / "t.npz", SHAPE)
