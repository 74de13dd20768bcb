"""`deepir run`: what a finished run leaves, and what it never touches."""

import json
import os
import shutil

import numpy as np
import pytest
import tifffile
from PIL import Image

ENDED = {
    "config.yaml",
    "run.json",
    "deepir.log",
    "result.npz",
    "uncertainty.npz",
    "scene.tiff",
    "scene_preview.png",
    "summary.png",
    "report.html",
    "metrics.json",
}
PLUGIN = '''
from deepir.fields.base import Pixels
from deepir.registry import register

@register("field", "my_pixels")
class MyPixels(Pixels):
    """Like pixels."""
'''


def held(folder):
    return {path.name for path in folder.iterdir()}


def test_a_finished_run_leaves_its_files_and_every_array_on_its_grid(nuc, folder):
    status, out, _ = nuc("data.path=burst.npz", "data.truth=burst_truth.npz")
    assert status == 0
    found = np.load("runs/nuc/result.npz")
    shapes = {name: found[name].shape for name in found}
    assert shapes == {
        "scene": (40, 48), "gain": (40, 48), "offset": (40, 48), "motion": (3, 3, 3), "level": (3,),
        "bad_pixels": (40, 48), "frames_used": (3,),
    }  # fmt: skip
    assert found["scene"].dtype == np.float32
    assert found["bad_pixels"].dtype == found["frames_used"].dtype == bool
    assert np.array_equal(tifffile.imread("runs/nuc/scene.tiff"), found["scene"])
    assert held(folder / "runs/nuc") == ENDED
    with Image.open("runs/nuc/summary.png") as picture:
        assert picture.width > 600
    with Image.open("runs/nuc/scene_preview.png") as picture:
        assert picture.size == (48, 40)
    assert "runs/nuc/result.npz" in out
    assert "PSNR" in out
    log = (folder / "runs/nuc/deepir.log").read_text()
    for words in ("torch", "sha256", "burst.npz", "1/3: loss", "finished"):
        assert words in log
    metrics = json.loads((folder / "runs/nuc/metrics.json").read_text(), parse_constant=pytest.fail)
    wanted = "seconds iterations evaluations stop_reason peak_memory_mb noise_sigma held_out_rmse strengths"
    assert {*wanted.split(), "psnr", "ssim", "psnr_aligned", "ssim_aligned"} <= set(metrics)
    assert 0 < metrics["seconds"] < 60
    assert 50 < metrics["peak_memory_mb"] < 5000


def test_the_average_has_the_same_metrics(averaged):
    metrics = json.loads((averaged / "metrics.json").read_text())
    assert metrics["held_out_rmse"] > 0
    assert metrics["strengths"] == {}


def test_overwrite_replaces_the_run_and_nothing_else(nuc, folder):
    (folder / "runs/nuc").mkdir(parents=True)
    (folder / "runs/nuc/notes.txt").write_text("mine")
    assert nuc("data.path=burst.npz", "seed=1")[0] == 0
    assert nuc("data.path=burst.npz", "seed=2", "--overwrite")[0] == 0
    assert held(folder / "runs/nuc") == ENDED | {"notes.txt"}
    assert "seed: 2" in (folder / "runs/nuc/config.yaml").read_text()


def test_overwriting_with_bad_data_keeps_the_former_run(nuc, averaged, burst):
    before = {path.name: path.read_bytes() for path in averaged.iterdir()}
    np.savez("still.npz", frames=burst.frames[[0, 0, 0]])
    assert nuc("data.path=still.npz", "--overwrite")[0] == 2
    assert {path.name: path.read_bytes() for path in averaged.iterdir()} == before


def test_files_that_no_run_wrote_are_safe_even_from_overwrite(refused, folder):
    (folder / "scene.tiff").write_text("mine")
    command = ("run", "nuc", "data.path=burst.npz", "output.dir=.", "--overwrite")
    refused(command, "scene.tiff, which no run of deepir wrote")
    assert (folder / "scene.tiff").read_text() == "mine"


def test_a_run_does_not_replace_its_own_input(averaged, refused):
    own = ("data.path=runs/nuc/result.npz", "data.key=scene")
    refused(("run", "nuc", *own, "--overwrite"), "would replace")


def test_the_written_configuration_runs_again(nuc, deepir, folder):
    nuc("data.path=burst.npz", "physics.sensor.offset=null", "scene.penalties.foe=null")
    first = np.load("runs/nuc/result.npz")["scene"]
    assert deepir("run", "runs/nuc/config.yaml", "output.dir=again", "scene.penalties.foe=null")[0] == 0
    assert np.array_equal(np.load("again/result.npz")["scene"], first)


def test_a_plugin_beside_the_user_is_found_and_resume_asks_for_it(nuc, deepir, folder, monkeypatch):
    (folder / "mine.py").write_text(PLUGIN)
    settings = ("data.path=burst.npz", "scene.type=my_pixels")
    assert nuc(*settings, "--plugin", "mine")[0] == 0
    assert "my_pixels" in deepir("list", "--plugin", "mine")[1]
    (folder / "runs/nuc/metrics.json").unlink()
    status, _, err = deepir("resume", "runs/nuc")
    assert status == 2
    assert "deepir resume runs/nuc --plugin mine" in err
    assert deepir("resume", "runs/nuc", "--plugin", "mine")[0] == 0


def test_a_diverging_solve_ends_with_status_1_and_keeps_its_state(nuc, folder, monkeypatch):
    monkeypatch.setattr("deepir.optim.lbfgs.LBFGS._at", lambda self, x: (float("nan"), x * float("nan")))
    status, _, err = nuc("data.path=burst.npz")
    assert status == 1
    assert "deepir: error: the objective is not a number" in err
    assert "checkpoint.safetensors" in held(folder / "runs/nuc")


@pytest.mark.parametrize(
    ("error", "words"),
    [
        (ZeroDivisionError(), "internal error, please report it: ZeroDivisionError"),
        (MemoryError(), "not enough memory"),
        (RuntimeError("DefaultCPUAllocator: not enough memory"), "data.crop"),
    ],
)
def test_something_unforeseen_is_one_line_and_a_traceback_in_the_log(nuc, folder, monkeypatch, error, words):
    def fail(*_, **__):
        raise error

    monkeypatch.setattr("deepir.pipeline.reconstruct.solve", fail)
    status, _, err = nuc("data.path=burst.npz")
    assert (status, "Traceback" in err) == (1, False)
    assert words in err.splitlines()[-1]
    assert "Traceback" in (folder / "runs/nuc/deepir.log").read_text()


def test_what_is_wrong_with_the_input_comes_before_a_former_run(averaged, refused):
    np.save("flat.npy", np.zeros((3, 40, 48), np.float32))
    wrong = {
        "data.path=none.npz": "none.npz: no such file",
        "device=none": "device: 'none' cannot be used here",
        "data.path=flat.npy": "flat.npy",
    }
    before = (averaged / "result.npz").read_bytes()
    for setting, message in wrong.items():
        refused(("run", "nuc", "data.path=burst.npz", setting), message)
    refused(("run", "nuc", "data.path=burst.npz"), "already contains a run (finished)", "--overwrite")
    assert (averaged / "result.npz").read_bytes() == before


@pytest.mark.parametrize("after", ["moved", "deleted", "replaced"])
def test_a_folder_that_is_lost_while_running_is_named(deepir, folder, monkeypatch, after):
    def lose(*_, **__):
        (folder / "run").rename(folder / "moved")
        if after != "moved":
            shutil.rmtree(folder / "moved")
        if after == "replaced":
            (folder / "run").mkdir()
            (folder / "run/result.npz").write_text("mine")

    command = ("run", "nuc", "data.path=burst.npz", "method=average", "output.dir=run")
    with monkeypatch.context() as patch:
        patch.setattr("deepir.runner.compare_to_truth", lambda *_: lose() or {})
        status, _, err = deepir(*command)
    assert status == 2
    assert "/run: this folder was moved or deleted while the run was at work" in err
    assert (folder / "moved").exists() == (after == "moved")
    if after == "moved":
        assert deepir("resume", "moved")[0] == 0
    if after == "replaced":
        assert held(folder / "run") == {"result.npz"}


def test_a_current_folder_that_was_deleted_is_one_line(deepir, folder):
    (folder / "gone").mkdir()
    os.chdir(folder / "gone")
    (folder / "gone").rmdir()
    assert deepir("list")[::2] == (2, "deepir: error: the current folder was deleted: go to another one\n")


def test_where_nothing_can_be_written_there_is_one_line(deepir, folder, monkeypatch):
    def refuse(*_, **__):
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("pathlib.Path.mkdir", refuse)
    monkeypatch.setattr("filelock.FileLock._acquire", refuse)
    for command in (
        "run nuc data.path=burst.npz",
        "compare nuc data.path=burst.npz seed=0,1",
        "simulate new.npz",
        "calibrate new.npz burst.npz",
        "demo",
    ):
        status, out, err = deepir(*command.split())
        assert (status, out, err.count("\n")) == (2, "", 1)
        assert "cannot be written: Permission denied" in err
