"""The other commands, and what the command line is like as a whole."""

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

import deepir as package
from deepir.cli import app
from deepir.simulate import Settings, simulate

WITHOUT = "import sys; sys.modules.update(dict.fromkeys({})); from deepir.cli import main; "
COMMANDS = [each.name for each in app.registered_commands]


def test_help_is_quick_and_does_without_torch():
    code = "import sys, deepir.cli as c; c.main(['--help']); print({'torch', 'numpy'} & set(sys.modules))"
    start = time.perf_counter()
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert time.perf_counter() - start < 0.5
    assert done.stdout.endswith("set()\n")
    assert all(f"\n  {command} " in done.stdout for command in COMMANDS)


def test_deepir_has_its_public_names_and_no_others():
    code = "import sys, deepir; print(dir(deepir), {'torch', 'numpy'} & set(sys.modules))"
    names = ["Corrector", "DeepIRError", "Problem", "Result", "__version__", "correct", "read_frames", "run"]
    assert subprocess.check_output([sys.executable, "-c", code], text=True) == f"{names} set()\n"
    assert all(getattr(package, name) for name in names)


def test_a_burst_is_described_and_a_run_analysed_without_torch(folder):
    moved = simulate(None, Settings(n_frames=3, shape=(40, 48)), seed=0)
    moved.save("moved.npz")
    maps = {"gain": np.ones((40, 48)), "offset": np.random.default_rng(0).normal(size=(40, 48))}
    motion = np.tile(np.eye(3), (3, 1, 1))
    motion[:, :2, 2] = [[0, 0], [4, 5], [-5, 3]]
    np.savez("result.npz", **maps, scene=moved.frames[0], motion=motion, bad_pixels=np.zeros((40, 48), bool))
    commands = "sys.exit(main(['check', 'moved.npz']) or main(['analyze', '.']))"
    code = WITHOUT.format(["torch", "matplotlib", "numba"]) + commands
    assert "this burst: 3 frames" in subprocess.check_output([sys.executable, "-c", code], text=True)


def test_a_recording_is_corrected_without_torch(folder):
    recording = simulate(None, Settings(n_frames=12, shape=(40, 48), counts=True), seed=0)
    np.savez("pan.npz", frames=recording.frames)
    np.savez("flat.npz", frames=np.random.default_rng(0).normal(8000, 30, (4, 40, 48)))
    steps = "['correct', 'pan.npz'], ['apply', 'pan_corrected_maps.npz', 'pan.npz', '--output', 'a.tif']"
    commands = f"sys.exit(any(map(main, ({steps}, ['calibrate', 'maps.npz', 'flat.npz']))))"
    subprocess.run([sys.executable, "-c", WITHOUT.format(["torch", "kornia"]) + commands], check=True)


def test_python_runs_the_package_which_says_its_version():
    said = subprocess.check_output([sys.executable, "-m", "deepir", "--version"], text=True)
    assert said == f"deepir {package.__version__}\n"


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_explains_itself(deepir, command):
    status, out, _ = deepir(command, "--help")
    assert status == 0
    assert f"Usage: deepir {command}" in out


def test_list_has_a_line_for_each_component(deepir):
    status, out, _ = deepir("list")
    assert status == 0
    for line in ("  joint ", "  average ", "  warp ", "  rigid ", "  tv ", "  gaussian ", "  nuc "):
        assert line in out
    assert all(len(line.split(maxsplit=1)) == 2 for line in out.splitlines() if line.startswith("  "))


def test_check_says_what_a_run_refuses(deepir, tmp_path):
    frames = np.random.default_rng(0).normal(size=(6, 96, 128))
    frames[:, ::2] = np.nan
    np.save(tmp_path / "lines.npy", frames)
    status, said, _ = deepir("check", tmp_path / "lines.npy")
    assert status == 2
    assert "a run refuses it" in said
    assert "no sample has finite neighbours" in said
    assert "to correct it" not in said


def test_check_proposes_what_suits_the_number_of_frames(deepir, folder):
    scene = np.random.default_rng(0).normal(8000, 100, (40, 140)).cumsum(1)
    frames = np.stack([scene[:, 2 * k : 2 * k + 48] for k in range(40)])
    np.save("drive.npy", frames.astype(np.float32))
    said = deepir("check", "drive.npy", "data.axes=nhw")[1]
    assert "to correct it: deepir correct drive.npy data.axes=nhw\n" in said
    said = deepir("check", "burst.npz")[1]
    assert "3 frame(s) of 40 x 48 px" in said
    assert "deepir run nuc data.path=burst.npz" in said


def test_check_sees_the_motion_that_a_run_sees(deepir, tmp_path):
    """Means of blocks show nothing of a fine scene."""
    scene = np.random.default_rng(0).normal(8000, 100, (96, 300)).astype(np.float32)
    noise = np.random.default_rng(1).normal(0, 2, (5, 96, 128))
    np.save(tmp_path / "fine.npy", np.stack([scene[:, 40 * k : 40 * k + 128] for k in range(5)]) + noise)
    said = deepir("check", tmp_path / "fine.npy")[1]
    assert "motion: yes, 40.0 px between frames, as a run registers them" in said


def test_check_and_analyze_name_torn_frames_and_what_is_drawn(deepir, folder, burst):
    frames = burst.frames.copy()
    frames[1, 24:] = frames[2, 24:]
    frames[:, 4:8, 4:16] = 9000
    np.savez("torn.npz", frames=frames)
    said = deepir("check", "torn.npz")[1]
    torn = "torn frame(s), of two times above and below a row: 1 (at row 24); leave them out: data.frames=[0, 2]"
    drawn = "48 pixel(s) between rows 4 and 7, columns 4 and 15 hold one value in all frames"
    assert torn in said
    assert drawn in said
    said = deepir("analyze", "torn.npz")[2]
    assert torn in said
    assert drawn in said


def test_check_describes_a_configuration_and_writes_nothing(deepir, folder):
    before = sorted(folder.rglob("*"))
    status, out, _ = deepir("check", "nuc", "data.path=burst.npz", "physics.warp.motion=affine")
    assert status == 0
    for words in ("problem nuc", "motion affine", "prior foe", "3 frame(s)", "runs/nuc (new)"):
        assert words in out
    assert sorted(folder.rglob("*")) == before


def test_check_of_a_configuration_needs_no_file(deepir):
    assert "data: none given" in deepir("check", "nuc")[1]
    status, out, _ = deepir("check", "nuc", "data.simulate={shape: [40, 48], n_frames: 4}", "seed=3")
    assert status == 0
    assert "the simulated burst (seed 3), 4 frames of 40 x 48 px" in out


def test_check_sees_a_former_run(deepir, averaged):
    assert "already contains a run (finished)" in deepir("check", "nuc")[1]


def test_simulate_writes_a_burst_or_a_recording_of_a_kind_and_its_truth(deepir, folder):
    status, out, _ = deepir("simulate", "new.npz", "n_frames=4", "shape=[32,48]", "counts=true", "--seed", "2")
    assert status == 0
    assert "new_truth.npz" in out
    stored = np.load("new.npz")
    assert stored["frames"].shape == (4, 32, 48)
    assert json.loads(str(stored["settings"]))["seed"] == 2
    assert np.load("new_truth.npz")["scene"].shape == (32, 48)
    status, out, err = deepir("simulate", "pan.npz", "kind=pan", "n_frames=3", "shape=[24,32]", "agc=true")
    assert status == 0, err
    assert "3 frames of 24 x 32 px" in out
    assert np.load("pan.npz")["frames"].dtype == np.uint8
    assert np.load("pan_truth.npz")["offset"].shape == (3, 24, 32)


def test_an_interrupted_simulation_writes_nothing(deepir, folder, monkeypatch):
    before = sorted(folder.iterdir())
    monkeypatch.setattr("deepir.simulate.simulate", lambda *_, **__: os.kill(os.getpid(), signal.SIGINT))
    assert deepir("simulate", "new.npz")[::2] == (130, "deepir: interrupted; nothing was written\n")
    assert sorted(folder.iterdir()) == before


@pytest.mark.parametrize("scene", ["camera", "sky:2", "scene.png"])
def test_simulate_takes_a_scene_by_name_or_a_picture(deepir, folder, scene):
    Image.fromarray(np.add.outer(np.arange(90), np.arange(120)).astype(np.uint8)).save("scene.png")
    status, _, err = deepir("simulate", "new.npz", "shape=[24,32]", "max_shift=2", "--scene", scene)
    assert status == 0, err


def test_demo_prints_what_it_gains_and_runs_again(deepir, folder, monkeypatch):
    monkeypatch.setattr("deepir.cli.runs.DEMO_SHAPE", (40, 48))
    for _ in range(2):
        status, out, err = deepir("demo")
        assert status == 0, err
        for words in ("one frame", "registered average", "deepir", "dB", "runs/demo/summary.png"):
            assert words in out
        assert Path("runs/demo/burst_truth.npz").exists()


def test_list_shows_one_kind_or_what_a_name_matches(deepir):
    status, out, _ = deepir("list", "fidelity")
    assert status == 0
    assert out.startswith("fidelities:\n")
    assert "penalties:" not in out
    _, out, _ = deepir("list", "noise")
    assert "  row_noise " in out
    assert "  line_noise " in out
    assert "  warp " not in out
