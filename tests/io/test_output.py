"""What is written is read again, whole or not at all; tones and palettes of what is looked at."""

import json
import os
import typing
from pathlib import Path

import numpy as np
import pytest
import recordings
import tifffile
from PIL import Image

from deepir.config.schema import Output
from deepir.errors import DataError
from deepir.io import atomic_file, output, read_frames, write_json, write_mat, write_npz, write_preview, write_tiff
from deepir.io.radiometry import Linear, unit_metadata
from deepir.io.tone_mapping import PALETTES, TONE_MAPPINGS, apply_palette, colour_table


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
    given_and_stored = {
        "psnr": (np.float32(31.5), 31.5),
        "frames": (np.int64(3), 3),
        "gain": (np.ones(2), [1.0, 1.0]),
        "crop": ((0, 20), [0, 20]),
        "source": (Path("a.npz"), "a.npz"),
        "worst": (float("nan"), None),
        "best": (np.array([np.inf]), [None]),
        "unit": ("°C", "°C"),
    }
    write_json(tmp_path / "a.json", {name: given for name, (given, _) in given_and_stored.items()})
    found = json.loads((tmp_path / "a.json").read_text(encoding="utf-8"))
    assert found == {name: stored for name, (_, stored) in given_and_stored.items()}


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


@pytest.mark.parametrize("dtype", [np.uint16, np.float32])
def test_a_tiff_of_many_pages_says_what_its_values_are(tmp_path, burst, dtype):
    with output.tiff(tmp_path / "a.tif", np.dtype(dtype), unit_metadata(Linear(0.04))) as write:
        for frame in burst:
            write(frame.astype(np.float32))
    read = read_frames(tmp_path / "a.tif")
    assert (read.dtype, read.radiometry) == (np.dtype(dtype).name, Linear(0.04))
    np.testing.assert_array_equal(read.frames, burst)
    with tifffile.TiffFile(tmp_path / "a.tif") as tiff:
        assert len(tiff.pages) == 3


def test_whole_numbers_are_rounded_and_cut():
    values = np.array([-3.0, 1.5, 2.5, 7.6, 1e6, np.nan], np.float32)
    assert output.cast(values, np.dtype(np.uint16)).tolist() == [0, 2, 2, 8, 65535, 0]
    assert output.cast(values, np.dtype(np.float32)) is values


def test_a_recording_keeps_its_type_where_that_can_hold_it():
    assert output.output_type(np.dtype(">u2"), rounded=True) == np.uint16
    for dtype, rounded in (("u2", False), ("i4", True), ("f8", True)):
        assert output.output_type(np.dtype(dtype), rounded=rounded) == np.float32


@pytest.mark.parametrize("tones", ["percentile", "clahe"])
def test_a_film_can_be_looked_at(tmp_path, tones):
    pytest.importorskip("av")
    ramp = np.tile(np.linspace(7000, 9000, 65), (3, 49, 1)).astype(np.float32)
    with output.mp4(tmp_path / "a.mp4", "white-hot", tones) as write:
        for frame in ramp:
            write(frame)
    shown = read_frames(tmp_path / "a.mp4").frames
    assert shown.shape == (3, 48, 64)
    assert np.corrcoef(shown[1].ravel(), ramp[1, :48, :64].ravel())[0, 1] > 0.98


def test_a_palette_is_seen_in_a_film(tmp_path):
    pytest.importorskip("av")
    with output.mp4(tmp_path / "a.mp4", "ironbow", "percentile") as write:
        write(np.tile(np.linspace(0, 1, 64), (48, 1)))
    with pytest.raises(DataError, match="carries no radiometry"):
        read_frames(tmp_path / "a.mp4")


def test_a_grey_film_that_a_codec_has_tinted_slightly_is_read(tmp_path):
    """The colour difference of all pixels is one below neutral, as in an MPEG-4 film of a thermal camera."""
    pytest.importorskip("av")
    ramp = np.tile(np.linspace(40, 200, 64).astype(np.uint8), (48, 1))
    picture = np.vstack((ramp, np.full((24, 64), 127, np.uint8)))
    recordings.film(tmp_path / "a.mkv", picture[None], stored="yuv420p", size=(48, 64))
    shown = read_frames(tmp_path / "a.mkv").frames[0]
    assert not np.isnan(shown).any()
    assert np.corrcoef(shown.ravel(), ramp.ravel())[0, 1] > 0.999


def test_another_name_is_answered_with_those_there_are(tmp_path):
    with pytest.raises(DataError, match=r"a\.avi: a recording is written as \.tif .* or \.mp4"):
        output.open_writer(tmp_path / "a.avi", np.dtype(np.uint16), {}, "white-hot", "percentile")


@pytest.fixture
def scene():
    """A cold and a hot part, each with little contrast of its own."""
    y, x = np.mgrid[:64, :96]
    return 290 + 60 * (x > 48) + np.sin(x / 3) + np.cos(y / 4)


@pytest.mark.parametrize("palette", PALETTES)
def test_palettes_go_from_cold_to_hot(palette):
    light = colour_table(palette) @ [0.299, 0.587, 0.114]
    assert colour_table(palette).shape == (256, 3)
    if palette == "black-hot":
        light = light[::-1]
    if palette != "turbo":  # a rainbow
        assert light[0] < 20
        assert (np.diff(light) > -1.5).all()
        assert light[-1] > 180


def test_white_hot_is_grey():
    np.testing.assert_array_equal(apply_palette(np.array([[0, 0.5, 1]]), "white-hot"), [[0, 128, 255]])
    np.testing.assert_array_equal(colour_table("white-hot")[:, 0], np.arange(256))


@pytest.mark.parametrize("tones", TONE_MAPPINGS)
def test_shades_lie_between_nought_and_one(scene, tones):
    scene[3, 4] = np.nan
    shades = TONE_MAPPINGS[tones](scene)
    assert shades.shape == scene.shape
    assert shades.min() >= 0
    assert shades.max() <= 1


def test_clahe_shows_both_parts(scene):
    cold = np.s_[:, :40]
    assert TONE_MAPPINGS["clahe"](scene)[cold].std() > 2 * TONE_MAPPINGS["percentile"](scene)[cold].std()


@pytest.mark.parametrize("tones", TONE_MAPPINGS)
@pytest.mark.parametrize("value", [7.0, np.nan])
def test_nothing_to_see_is_black(tones, value):
    assert not TONE_MAPPINGS[tones](np.full((20, 24), value)).any()


def test_all_can_be_chosen():
    choices = {key: typing.get_args(field.annotation) for key, field in Output.model_fields.items()}
    assert choices["palette"] == PALETTES
    assert choices["tones"] == tuple(TONE_MAPPINGS)
