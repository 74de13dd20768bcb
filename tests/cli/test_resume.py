"""`deepir resume`: after any interruption the scene is that of a run that was left alone.

The last test counts a few of what `make reliability` counts: runs that are killed, race for a folder, or find a
damaged state.
"""

import os
import shutil
import signal
import subprocess
import sys
from contextlib import chdir, contextmanager, nullcontext
from pathlib import Path

import numpy as np
import pytest
from documentation import ROOT

from deepir.api import run
from deepir.cli import main
from deepir.cli.terminal import Interrupted, Interruptible
from deepir.errors import DataError
from deepir.storage.folder import RunFolder

RUN = ("run", "nuc", "data.path=burst.npz", "threads=1", "solver.max_iterations=3")


@pytest.fixture(scope="module")
def scene(burst):
    """The scene of a run that is left alone."""
    return run("nuc", "solver.max_iterations=3", frames=burst.frames, threads=1).scene


@contextmanager
def signalled(number, iteration):
    """A context in which a signal is sent to this process at the n-th iteration."""
    count = iter(range(1, 10_000))

    def callback(progress):
        if next(count) == iteration:
            os.kill(os.getpid(), number)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("deepir.report.progress.show_progress", lambda: nullcontext(callback))
        yield


@pytest.fixture(scope="module")
def stopped(burst, tmp_path_factory):
    """The folder of a run that a signal ended at its fifth iteration; its input lies elsewhere."""
    folder = tmp_path_factory.mktemp("stopped")
    burst.save(folder / "burst.npz")
    with signalled(signal.SIGTERM, 5), chdir(folder):
        assert main(RUN) == 143
    return folder / "runs/nuc"


@pytest.fixture
def interrupted(folder, stopped):
    """The same run, in the working folder."""
    return Path(shutil.copytree(stopped, folder / "runs/nuc"))


@pytest.fixture
def resumed(deepir, scene):
    """Resume the run: its scene is that of a run that was left alone; what is printed on stderr."""

    def run():
        status, _, err = deepir("resume", "runs/nuc")
        assert status == 0
        assert np.array_equal(np.load("runs/nuc/result.npz")["scene"], scene)
        return err

    return run


@pytest.mark.parametrize(
    ("number", "status", "iteration"), [(signal.SIGINT, 130, 1), (signal.SIGINT, 130, 6), (signal.SIGTERM, 143, 13)]
)
def test_after_a_signal(deepir, resumed, number, status, iteration):
    with signalled(number, iteration):
        found, _, err = deepir(*RUN)
    assert found == status
    assert "deepir resume runs/nuc" in err
    assert "starts again" not in resumed()


def test_twice(deepir, interrupted, resumed):
    with signalled(signal.SIGTERM, 4):
        status, _, err = deepir("resume", "runs/nuc")
    assert status == 143
    assert "starts again" not in err
    resumed()


def test_a_signal_while_registering_ends_the_run_at_once(deepir, resumed, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr("deepir.pipeline.register.register", lambda *a, **k: os.kill(os.getpid(), signal.SIGINT))
        status, _, err = deepir(*RUN)
    assert status == 130
    assert "before the first checkpoint" in err
    resumed()


def test_the_second_signal_ends_at_once():
    with Interruptible() as interruptible:
        interruptible(None)
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(Interrupted):
            os.kill(os.getpid(), signal.SIGINT)


def test_one_process_at_a_time_resumes_it_from_any_folder_tidies_up_and_finishes_it_once(
    deepir, refused, interrupted, scene, tmp_path_factory
):
    refused(RUN, "(interrupted); continue it with", f"deepir resume {interrupted}")
    with RunFolder(interrupted).lock():
        refused(("resume", "runs/nuc"), f"another process is at work here (process {os.getpid()} on ")
    for name in (".result.0123abcd.npz", "checkpoint.part", ".notes.0123abcd.txt"):  # the last is no file of a run
        (interrupted / name).write_text("half")
    with chdir(tmp_path_factory.mktemp("elsewhere")):
        assert deepir("resume", interrupted)[0] == 0
    assert np.array_equal(np.load(interrupted / "result.npz")["scene"], scene)
    left = {path.name for path in interrupted.iterdir()}
    assert not {".result.0123abcd.npz", "checkpoint.part"} & left
    assert ".notes.0123abcd.txt" in left
    before = (interrupted / "result.npz").stat().st_mtime_ns
    assert deepir("resume", "runs/nuc")[:2] == (0, "runs/nuc: already finished\n")
    assert (interrupted / "result.npz").stat().st_mtime_ns == before


def test_a_changed_input_is_refused(deepir, refused, folder, burst):
    with signalled(signal.SIGTERM, 1):
        deepir(*RUN)
    np.savez(folder / "burst.npz", frames=burst.frames[:, ::-1])
    refused(("resume", "runs/nuc"), "burst.npz has changed since the run started")


def test_a_broken_checkpoint_is_reported_and_the_run_starts_again(interrupted, resumed):
    path = interrupted / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:100])
    err = resumed()
    assert "cannot be used" in err
    assert "starts again" in err


def test_a_run_killed_before_its_record_starts_again(interrupted, resumed):
    for name in ("run.json", "checkpoint.safetensors", "deepir.log"):
        (interrupted / name).unlink()
    resumed()


def test_a_checkpoint_of_another_run_is_reported_and_the_run_starts_again(deepir, interrupted, resumed):
    with signalled(signal.SIGTERM, 5):
        deepir(*RUN, "seed=1", "output.dir=runs/other")
    (interrupted.parent / "other/checkpoint.safetensors").replace(interrupted / "checkpoint.safetensors")
    err = resumed()
    assert "of other frames, another configuration or another version" in err
    assert "starts again" in err


@pytest.mark.parametrize("field", [{"history": 5}, {"history": [3]}, {"stage": "x"}, {"iteration": 99}, {"more": 1}])
def test_a_history_of_odd_types_is_one_line(small_nuc, tmp_path, field):
    from deepir.optim.objective import Position, restore_state, save_state
    from deepir.storage.stored import FileCheckpoint

    checkpoint, problem = FileCheckpoint(tmp_path / "a.safetensors"), small_nuc()
    save_state(problem, [], Position(), checkpoint)
    tensors, position = checkpoint.load()
    checkpoint.save(tensors, position | field)
    with pytest.raises(DataError, match="the state of another problem"):
        restore_state(problem, [], checkpoint)


def test_a_replacement_is_interrupted_and_resumed(deepir, folder, resumed):
    deepir(*RUN, "seed=1")
    before = (folder / "runs/nuc/result.npz").read_bytes()
    with signalled(signal.SIGTERM, 5):
        status, _, err = deepir(*RUN, "--overwrite")
    assert status == 143
    assert "go on with: deepir resume runs/nuc" in err
    assert (folder / "runs/nuc/result.npz").read_bytes() == before
    assert "(interrupted); continue it with" in deepir(*RUN)[2]
    resumed()
    assert not (folder / "runs/nuc/.unfinished").exists()


@pytest.mark.parametrize(
    ("parts", "count"),
    [
        (("kills",), 1),
        pytest.param(("kills", "races", "flipped bits"), 20, marks=[pytest.mark.slow, pytest.mark.timeout(600)]),
    ],
)
def test_a_result_is_whole_and_that_of_a_run_left_alone(parts, count):
    code = (
        "from reliability_runs import count_runs\n"
        f"for part in {parts}:\n"
        f"    print(part, count_runs(part, 0, {count})['failed'])"
    )
    command = [sys.executable, "-c", code]
    done = subprocess.run(command, cwd=ROOT / "benchmarks", capture_output=True, text=True, check=False)
    assert done.stdout == "".join(f"{part} 0\n" for part in parts), done.stderr
