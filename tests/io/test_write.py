import json
import os
from pathlib import Path

import numpy as np
import pytest
import tifffile
from PIL import Image

from deepir.errors import DataError
from deepir.io import atomic_file, read_frames, write_json, write_mat, write_npz, write_preview, write_tiff


def test_a_failed_write_leaves_the_old_file_and_nothing_else(tmp_path):
    target = tmp_path / "result.txt"
    target.write_text("old")

    def write_half():
        with atomic_file(target) as temporary:
            temporary.write_text("new, but only half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        write_half()
    assert target.read_text() == "old"
    assert list(tmp_path.iterdir()) == [target]


def test_until_the_end_readers_see_the_old_file(tmp_path):
    target = tmp_path / "result.txt"
    target.write_text("old")
    with atomic_file(target) as temporary:
        temporary.write_text("new")
        assert target.read_text() == "old"
        assert temporary.parent == target.parent
    assert target.read_text() == "new"


@pytest.mark.skipif(os.name != "posix", reason="permissions of POSIX")
def test_results_are_as_readable_as_any_new_file(tmp_path):
    (tmp_path / "any").touch()
    write_json(tmp_path / "a.json", {})
    assert (tmp_path / "a.json").stat().st_mode == (tmp_path / "any").stat().st_mode


@pytest.mark.parametrize("folder", ["nowhere", "a_file"])
def test_where_nothing_can_be_written_the_file_is_named(tmp_path, folder):
    (tmp_path / "a_file").touch()
    with pytest.raises(DataError, match=r"a\.json: cannot be written: (No such file|Not a)"):
        write_json(tmp_path / folder / "a.json", {})


@pytest.mark.parametrize(("name", "write"), [("a.npz", write_npz), ("a.mat", write_mat)])
def test_arrays_come_back_exactly(tmp_path, burst, name, write):
    write(tmp_path / name, {"raw": burst[0], "gain": np.ones(3)})
    np.testing.assert_array_equal(read_frames(tmp_path / name).frames[0], burst[0])


def test_npz_takes_no_objects(tmp_path):
    with pytest.raises(DataError, match="'odd' holds Python objects"):
        write_npz(tmp_path / "a.npz", {"odd": np.array([{}])})
    assert not list(tmp_path.iterdir())


def test_json_takes_what_results_are_made_of(tmp_path):
    content = {
        "psnr": np.float32(31.5),
        "frames": np.int64(3),
        "gain": np.ones(2),
        "crop": (0, 20),
        "source": Path("a.npz"),
        "worst": float("nan"),
        "best": np.array([np.inf]),
        "unit": "°C",
    }
    write_json(tmp_path / "a.json", content)
    assert json.loads((tmp_path / "a.json").read_text(encoding="utf-8")) == {
        "psnr": 31.5,
        "frames": 3,
        "gain": [1.0, 1.0],
        "crop": [0, 20],
        "source": "a.npz",
        "worst": None,
        "best": [None],
        "unit": "°C",
    }


@pytest.mark.parametrize("count", [None, 1, 3, 4])
def test_tiff_keeps_values_pages_and_metadata(tmp_path, count):
    shape = (20, 24) if count is None else (count, 20, 24)
    frames = np.random.default_rng(0).normal(8000, 40, shape)
    write_tiff(tmp_path / "a.tif", frames, {"prior": "tv", "unit": "°C", "sigma": np.float64(6)})
    np.testing.assert_array_equal(read_frames(tmp_path / "a.tif").frames, frames.reshape(-1, 20, 24).astype("f4"))
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        assert len(tiff.pages) == (count or 1)
        assert json.loads(tiff.pages[0].description) == {"prior": "tv", "unit": "°C", "sigma": 6.0}


def preview(path, image):
    write_preview(path, image)
    with Image.open(path) as picture:
        assert picture.mode == "L"
        return np.asarray(picture)


def test_preview_is_white_hot_and_outliers_do_not_matter(tmp_path):
    image = np.tile(np.linspace(290, 310, 200), (100, 1))
    image[0, 0], image[1, 1] = 1e6, np.nan
    tones = preview(tmp_path / "a.png", image)
    assert tones[50, 0] == 0
    assert tones[50, -1] == 255
    assert tones[1, 1] == 0
    assert tones[50, 100] == pytest.approx(128, abs=2)


@pytest.mark.parametrize(("palette", "mode"), [("white-hot", "L"), ("ironbow", "RGB")])
@pytest.mark.parametrize("tones", ["percentile", "clahe"])
def test_a_preview_has_colours_and_tones_of_ones_choice(tmp_path, palette, mode, tones):
    write_preview(tmp_path / "a.png", np.tile(np.linspace(290, 310, 64), (48, 1)), palette, tones)
    with Image.open(tmp_path / "a.png") as picture:
        assert (picture.mode, picture.size) == (mode, (64, 48))
