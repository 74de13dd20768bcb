"""The reader of recordings and runs for napari."""

from pathlib import Path

import numpy as np
import yaml

import deepir
from deepir.napari import reader
from deepir.result import neutral

MANIFEST = Path(deepir.__file__).with_name("napari.yaml")


def test_a_recording_is_one_layer_of_frames(tmp_path):
    frames = np.arange(3 * 16 * 20, dtype=np.float32).reshape(3, 16, 20)
    np.save(tmp_path / "walk.npy", frames)
    path = str(tmp_path / "walk.npy")
    ((found, options, kind),) = reader(path)(path)
    assert np.array_equal(found, frames)
    assert (options["name"], kind) == ("walk", "image")


def test_a_run_shows_its_scene_and_its_maps(tmp_path):
    neutral(np.ones((16, 20)), 2, (16, 20), np.zeros((16, 20), bool)).save(tmp_path)
    layers = reader(str(tmp_path))(str(tmp_path))
    assert [options["name"] for _, options, _ in layers] == ["scene", "gain", "offset", "bad pixels"]
    assert [options.get("visible", True) for _, options, _ in layers] == [True, False, False, False]


def test_other_files_are_left_to_other_readers(tmp_path):
    assert reader(str(tmp_path)) is None
    assert reader([str(tmp_path / "a.npy"), str(tmp_path / "b.npy")]) is None


def test_the_manifest_names_the_reader():
    (command,) = yaml.safe_load(MANIFEST.read_text())["contributions"]["commands"]
    assert command["python_name"] == f"{reader.__module__}:{reader.__name__}"
