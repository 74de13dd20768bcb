"""`deepir resume`: after any interruption the scene is that of a run that was left alone."""

import os
import re
import signal
from contextlib import contextmanager, nullcontext

import numpy as np
import pytest

from deepir.api import run
from deepir.cli.signals import Interrupted, Interruptible

RUN = ("run", "nuc", "data.path=burst.npz", "threads=1", "solver.max_iterations=8")


@pytest.fixture(scope="module")
def scene(simulation):
    """The scene of a run that is left alone."""
    return run("nuc", "solver.max_iterations=8", frames=simulation.frames, threads=1).scene


@pytest.fixture
def signalled(monkeypatch):
    """Send a signal to this process at the n-th iteration."""

    @contextmanager
    def at(number, iteration):
        count = iter(range(1, 10_000))

        def callback(progress):
            if next(count) == iteration:
                os.kill(os.getpid(), number)

        with monkeypatch.context() as patch:
            patch.setattr("deepir.report.progress.show_progress", lambda: nullcontext(callback))
            yield

    return at


@pytest.mark.parametrize(
    ("number", "status", "iteration"),
    [(signal.SIGINT, 130, 1), (signal.SIGTERM, 143, 5), (signal.SIGINT, 130, 8), (signal.SIGTERM, 143, 13)],
)
def test_after_a_signal(deepir, scene, signalled, number, status, iteration):
    with signalled(number, iteration):
        found, _, err = deepir(*RUN)
    assert found == status
    assert "deepir resume runs/nuc" in err
    assert deepir("resume", "runs/nuc")[0] == 0
    assert np.array_equal(np.load("runs/nuc/result.npz")["scene"], scene)


def test_twice(deepir, scene, signalled):
    with signalled(signal.SIGTERM, 3):
        deepir(*RUN)
    with signalled(signal.SIGTERM, 4):
        assert deepir("resume", "runs/nuc")[0] == 143
    assert deepir("resume", "runs/nuc")[0] == 0
    assert np.array_equal(np.load("runs/nuc/result.npz")["scene"], scene)


def test_a_signal_while_registering_ends_the_run_at_once(deepir, folder, scene, monkeypatch):
    with monkeypatch.context() as patch:
        patch.setattr(
            "deepir.pipeline.register.register", lambda *a, **k: os.kill(os.getpid(), signal.SIGINT)
        )
        status, _, err = deepir(*RUN)
    assert status == 130
    assert "before the first checkpoint" in err
    assert deepir("resume", "runs/nuc")[0] == 0
    assert np.array_equal(np.load("runs/nuc/result.npz")["scene"], scene)


def test_the_second_signal_ends_at_once():
    with Interruptible() as interruptible:
        interruptible(None)
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(Interrupted):
            os.kill(os.getpid(), signal.SIGINT)


def test_a_finished_run_has_nothing_to_resume(deepir, folder):
    deepir(*RUN)
    before = (folder / "runs/nuc/result.npz").stat().st_mtime_ns
    status, out, _ = deepir("resume", "runs/nuc")
    assert (status, out) == (0, "runs/nuc: already finished\n")
    assert (folder / "runs/nuc/result.npz").stat().st_mtime_ns == before


@pytest.fixture
def interrupted(deepir, folder, signalled):
    with signalled(signal.SIGTERM, 5):
        deepir(*RUN)
    return folder / "runs/nuc"


def test_another_run_names_the_way_to_resume(deepir, interrupted):
    status, _, err = deepir(*RUN)
    assert status == 2
    assert re.search(r"interrupted.*deepir resume \S+runs/nuc", err)


def test_a_changed_input_is_refused(deepir, folder, interrupted, simulation):
    np.savez(folder / "burst.npz", frames=simulation.frames[:, ::-1])
    status, _, err = deepir("resume", "runs/nuc")
    assert status == 2
    assert "burst.npz has changed since the run started" in err


@pytest.mark.parametrize("keep", [0, 100, 5000])
def test_a_broken_checkpoint_is_reported_and_the_run_starts_again(deepir, interrupted, scene, keep):
    path = interrupted / "checkpoint.safetensors"
    path.write_bytes(path.read_bytes()[:keep])
    status, _, err = deepir("resume", "runs/nuc")
    assert status == 0
    assert "not a readable checkpoint" in err
    assert "starting again" in err
    assert np.array_equal(np.load("runs/nuc/result.npz")["scene"], scene)


def test_a_run_killed_before_its_record_starts_again(deepir, interrupted, scene):
    for name in ("run.json", "checkpoint.safetensors", "deepir.log"):
        (interrupted / name).unlink()
    assert deepir("resume", "runs/nuc")[0] == 0
    assert np.array_equal(np.load("runs/nuc/result.npz")["scene"], scene)


def test_it_works_from_another_folder(deepir, interrupted, scene, tmp_path_factory, monkeypatch):
    monkeypatch.chdir(tmp_path_factory.mktemp("elsewhere"))
    assert deepir("resume", interrupted)[0] == 0
    assert np.array_equal(np.load(interrupted / "result.npz")["scene"], scene)


def test_half_written_files_are_cleared_away(deepir, interrupted):
    (interrupted / ".result.0123abcd.npz").write_text("half")
    (interrupted / "checkpoint.part").write_text("half")
    (interrupted / ".notes.0123abcd.txt").write_text("mine")
    deepir("resume", "runs/nuc")
    left = {path.name for path in interrupted.iterdir()}
    assert not {".result.0123abcd.npz", "checkpoint.part"} & left
    assert ".notes.0123abcd.txt" in left


def test_one_process_at_a_time(deepir, interrupted):
    from deepir.storage.folder import RunFolder

    with RunFolder(interrupted).logging():
        status, _, err = deepir("resume", "runs/nuc")
    assert status == 2
    assert "another process is at work" in err
