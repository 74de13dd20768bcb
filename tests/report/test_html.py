"""`report.html` as a file: what it holds, how large it is, and that nothing in it can act."""

import base64
import re
import time
import zlib

import numpy as np
import pytest

from deepir.messages import labelled
from deepir.report.html import MISSING_LEVEL, pack_map, write_report
from deepir.result import neutral


def unpacked(found):
    planes = np.frombuffer(zlib.decompress(base64.b64decode(found["levels"])), np.uint8).reshape(2, -1)
    differences = (256 * planes[0].astype(np.uint16) + planes[1]).reshape(found["height"], found["width"])
    levels = np.cumsum(differences, axis=1, dtype=np.uint16)
    return np.where(levels == MISSING_LEVEL, np.nan, found["base"] + found["step"] * levels)


@pytest.fixture
def report(tmp_path, result, example, config):
    """Write the report; its path."""

    def write():
        write_report(tmp_path / "report.html", result, example, config)
        return tmp_path / "report.html"

    return write


@pytest.mark.parametrize("outlier", [0.0, 16383.0, 1e9, -1e30, np.nan, np.inf])
def test_a_map_is_read_to_a_256th_of_what_it_shows_whatever_one_pixel_does(outlier):
    image = np.random.default_rng(0).normal(8000, 20, (60, 80))
    image[7, 9] = outlier
    found = pack_map(image)
    read, known = unpacked(found), np.isfinite(image)
    known[7, 9] = False
    assert np.abs(read - image)[known].max() <= (found["high"] - found["low"]) / 256
    assert np.isnan(read[7, 9]) == (not np.isfinite(outlier))


@pytest.mark.parametrize("image", [np.full((4, 5), 3.0), np.full((4, 5), np.nan), np.zeros((1, 1)), np.eye(4) > 0])
def test_a_map_without_shades_is_read_as_it_is(image):
    found = pack_map(image)
    np.testing.assert_allclose(unpacked(found), image)
    assert found["high"] > found["low"]


def test_a_map_in_the_order_of_matlab_is_a_map():
    image = np.arange(12.0).reshape(3, 4)
    assert pack_map(np.asfortranarray(image)) == pack_map(image)


def test_a_report_holds_every_map_of_the_run(report, data, example):
    maps = {each["name"]: each for each in data(report())["maps"]}
    assert list(maps) == [
        "raw", "scene", "scene_kelvin", "gain", "offset", "stray", "psf", "bad_pixels",
        "scene_sd", "gain_sd", "offset_sd",
    ]  # fmt: skip
    assert (maps["scene"]["unit"], maps["scene_kelvin"]["unit"], maps["gain"]["unit"]) == ("counts", "K", "")
    np.testing.assert_allclose(unpacked(maps["raw"]), example, atol=maps["raw"]["step"])
    assert maps["gain"]["low"] + maps["gain"]["high"] == pytest.approx(2)


def test_where_each_frame_has_a_scene_of_its_own_some_are_shown(report, data, result, example):
    result.scene = np.stack([result.scene + each for each in range(8)])
    result.extra = {"scene_kelvin": 200 + 0.01 * result.scene, "flow": np.zeros((8, 2, *example.shape))}
    result.uncertainty["scene"] = np.ones(result.scene.shape)
    names = [each["name"] for each in data(report())["maps"]]
    assert [name for name in names if name.startswith("scene")] == [
        "scene", "scene_2", "scene_5", "scene_7",
        "scene_kelvin", "scene_kelvin_2", "scene_kelvin_5", "scene_kelvin_7", "scene_sd",
    ]  # fmt: skip


def test_no_text_ends_the_data_or_starts_an_element(report, data, result):
    result.messages = ["</script><script>alert(1)</script>", "<!-- <img src=x onerror=alert(2)> %script%"]
    page = report().read_text(encoding="utf-8")
    assert page.count("<script") == 2
    assert "<img" not in page
    assert data(report())["messages"] == labelled(result.messages)


def test_a_page_loads_nothing(report):
    page = report().read_text(encoding="utf-8")
    assert not re.search(r"\b(src|href)=|@import|url\(", page)
    assert "default-src 'none'" in page


def test_the_report_of_a_camera_of_640_x_512_is_small_and_quick(tmp_path, config):
    rng = np.random.default_rng(0)
    size = (512, 640)
    result = neutral(rng.normal(8000, 200, size), 10, size, np.zeros(size, bool))
    result.gain, result.offset = rng.normal(1, 0.03, size), rng.normal(0, 90, size)
    result.uncertainty = {name: rng.normal(5, 0.5, size) for name in ("scene", "gain", "offset")}
    write_report(tmp_path / "report.html", result, result.scene, config)
    start = time.perf_counter()
    write_report(tmp_path / "report.html", result, result.scene, config)
    assert time.perf_counter() - start < 2  # 0.3 s alone
    assert (tmp_path / "report.html").stat().st_size < 5e6  # all noise: the worst case
