"""`deepir compare` and `deepir batch`; all but the last tests run their cells one after another, without a cluster."""

import csv
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from deepir.sweep.cluster import finish_cell

pytest.importorskip("distributed")

SMALL = "data.simulate={counts: true, shape: [40, 48], max_shift: 4, motion: shift}"
COMPARE = ("compare", "nuc", SMALL, "threads=1", "solver.max_iterations=3")
METHODS = (*COMPARE, "method=average,joint", "seed=0,1")
AVERAGES = (*COMPARE, "method=average", "seed=0,1")  # which take no solve
FAILS = '''
from deepir.baselines.rival import average
from deepir.errors import DataError
from deepir.registry import register

@register("method", "picky")
def picky(burst, config):
    """Takes even seeds only."""
    if config.seed % 2:
        raise DataError("an odd seed")
    return average(burst, config)
'''
SLOW_START = '''
import time
from deepir.baselines.rival import average
from deepir.registry import register

started = []

@register("method", "slow_start")
def slow_start(burst, config):
    """Takes its time once in a process."""
    if not started:
        time.sleep(1)
    started.append(True)
    return average(burst, config)
'''
DIES = '''
import os, signal
from pathlib import Path
from deepir.pipeline.reconstruct import joint
from deepir.registry import register
from deepir.optim.solve import solve

solve.__kwdefaults__["every"] = 0.0  # seconds between checkpoints: a short run has some

@register("method", "fragile")
def fragile(burst, config, *, callbacks=(), checkpoint=None):
    """Its process is killed in the middle of the first try."""
    def kill(progress):
        once = Path(config.output.dir).parent / "killed"
        if config.seed == 0 and progress.stage == "scene" and not once.exists():
            once.touch()
            os.kill(os.getpid(), signal.SIGKILL)
    return joint(burst, config, callbacks=[*callbacks, kill], checkpoint=checkpoint)
'''


@pytest.fixture
def here(monkeypatch):
    """No cluster: the cells are run in this process, in order."""

    def outcomes(cells, *, workers, scheduler, plugins):
        for cell in cells:
            yield cell, finish_cell(cell, plugins)

    monkeypatch.setattr("deepir.sweep.cluster.run_cells", outcomes)


def table(folder):
    with (folder / "table.csv").open() as file:
        return list(csv.DictReader(file))


@pytest.mark.usefixtures("here")
class TestHere:
    def test_a_comparison_leaves_a_folder_for_each_run_and_a_table(self, deepir, folder):
        status, out, err = deepir(*METHODS)
        assert status == 0, err
        made = {path.name for path in (folder / "runs/nuc-compare").iterdir()}
        cells = {f"method={method},seed={seed}" for method in ("average", "joint") for seed in (0, 1)}
        assert made == cells | {"table.csv", "table.md", "quality.png", "report.html"}
        for words in ("joint", "2/2", "PSNR (dB)", "radiometric error", "runs/nuc-compare/table.md"):
            assert words in out
        assert "deepir: 4/4 method=joint,seed=1: PSNR (dB)" in err
        found = table(folder / "runs/nuc-compare")
        assert [row["method"] for row in found] == ["average", "average", "joint", "joint"]
        assert float(found[2]["psnr_aligned"]) > float(found[0]["psnr_aligned"]) + 5

    def test_without_a_truth_the_average_has_a_held_out_error_too(self, deepir, folder):
        given = ("compare", "nuc", "data.path=burst.npz", "threads=1", "solver.max_iterations=3")
        status, out, err = deepir(*given, "method=average,joint")
        assert status == 0, err
        assert "held-out error" in out
        average, joint = (float(row["held_out_rmse"]) for row in table(folder / "runs/nuc-compare"))
        assert 0 < joint < average
        assert (folder / "runs/nuc-compare/quality.png").exists()

    def test_loading_and_compiling_is_no_part_of_the_seconds(self, deepir, folder, monkeypatch):
        (folder / "slow_start.py").write_text(SLOW_START)
        status, _, err = deepir(*COMPARE, "method=slow_start", "seed=0,1", "--plugin", "slow_start")
        assert status == 0, err
        row, _ = table(folder / "runs/nuc-compare")
        assert float(row["seconds"]) < 0.3

    def test_what_is_finished_is_kept_and_other_settings_want_another_folder_or_overwrite(self, deepir, folder):
        deepir(*AVERAGES)
        before = {path: path.stat().st_mtime_ns for path in folder.rglob("result.npz")}
        status, _, err = deepir(*AVERAGES[:-1], "seed=0,1,2")
        assert status == 0
        assert "2 of 3 runs are finished already" in err
        after = {path: path.stat().st_mtime_ns for path in folder.rglob("result.npz")}
        assert before.items() < after.items()
        assert len(after) == 3
        other = (*AVERAGES, "solver.max_iterations=2")
        status, _, err = deepir(*other)
        assert status == 2
        assert "solver.max_iterations=3, not 2" in err
        assert "2 of 2 runs are finished already" in deepir(*AVERAGES, "threads=2")[2]
        assert deepir(*other, "output.dir=runs/other")[0] == 0
        assert deepir(*other, "--overwrite")[0] == 0

    def test_a_run_that_fails_is_reported_and_the_rest_goes_on(self, deepir, folder):
        (folder / "picky_method.py").write_text(FAILS)
        status, out, err = deepir(*COMPARE, "method=picky", "seed=0,1,2", "--plugin", "picky_method")
        assert status == 1
        assert "deepir: 2/3 seed=1: failed: an odd seed" in err
        assert "2/3" in out
        assert [row["error"] for row in table(folder / "runs/nuc-compare")] == ["", "an odd seed", ""]
        assert "- `seed=1`: an odd seed" in (folder / "runs/nuc-compare/table.md").read_text()

    def test_ctrl_c_keeps_what_is_finished(self, deepir, folder, monkeypatch):
        def interrupted(cells, *, workers, scheduler, plugins):
            yield cells[0], finish_cell(cells[0], plugins)
            os.kill(os.getpid(), signal.SIGINT)

        with monkeypatch.context() as patch:
            patch.setattr("deepir.sweep.cluster.run_cells", interrupted)
            status, _, err = deepir(*AVERAGES)
        assert status == 130
        assert "the same command continues" in err
        assert [row["seconds"] != "" for row in table(folder / "runs/nuc-compare")] == [True, False]
        assert "1 of 2 runs are finished already" in deepir(*AVERAGES)[2]

    def test_frames_of_a_file_are_its_first(self, deepir, folder):
        settings = ("data.path=burst.npz", "data.truth=burst_truth.npz", "method=average", "data.frames=2,[0, 1, 2]")
        status, out, _ = deepir("compare", "nuc", *settings)
        assert status == 0
        assert "[0, 1, 2]" in out
        assert [row["frames"] for row in table(folder / "runs/nuc-compare")] == ["2", "3"]

    def test_a_batch_corrects_each_burst(self, deepir, folder, burst):
        (folder / "bursts").mkdir()
        burst.save(folder / "bursts/a.npz")
        np.savez("bursts/b.npz", frames=burst.frames[::-1])
        (folder / "bursts/c.npz").write_text("no burst")
        status, _, err = deepir("batch", "nuc", "bursts/*.npz", "method=average")
        assert status == 1
        assert "c: failed: " in err
        a, b, c = table(folder / "runs/nuc-batch")
        assert a["psnr_aligned"]
        assert (b["psnr_aligned"], b["error"]) == ("", "")
        assert "does not begin as a .npz file does" in c["error"]
        assert (folder / "runs/nuc-batch/a/scene.tiff").exists()


@pytest.mark.slow
def test_a_worker_that_is_killed_is_replaced_and_its_run_goes_on(deepir, folder):
    (folder / "fragile_method.py").write_text(DIES)
    given = (*COMPARE, "seed=0,1", "method=fragile", "--plugin", "fragile_method", "--workers", "2")
    status, _, err = deepir(*given)
    assert status == 0, err
    runs = folder / "runs/nuc-compare"
    log = (runs / "seed=0/deepir.log").read_text()
    assert log.count("INFO input") == 2
    assert log.count("sensor 1 1/3") == 1  # the second worker goes on from the first one's checkpoint
    deepir("run", "nuc", SMALL, "threads=1", "solver.max_iterations=3", "output.dir=alone")
    scenes = [np.load(path / "result.npz")["scene"] for path in (runs / "seed=0", folder / "alone")]
    np.testing.assert_array_equal(*scenes)


def test_a_cluster_that_runs_already_is_used(deepir, folder):
    from distributed import LocalCluster

    with LocalCluster(1, processes=False, threads_per_worker=2, protocol="tcp", dashboard_address=None) as cluster:
        status, _, err = deepir(*AVERAGES, "--scheduler", cluster.scheduler_address)
    assert status == 0, err
    assert len(table(folder / "runs/nuc-compare")) == 2


def test_a_scheduler_that_does_not_answer(deepir, folder, monkeypatch):
    monkeypatch.setattr("deepir.sweep.cluster.SCHEDULER_TIMEOUT", "1s")
    status, _, err = deepir(*COMPARE, "seed=0,1", "--scheduler", "tcp://127.0.0.1:1")
    assert status == 2
    assert "--scheduler tcp://127.0.0.1:1: no Dask scheduler answers" in err


@pytest.mark.slow
def test_ctrl_c_in_a_terminal_ends_the_workers_too(deepir, folder):
    program = "import sys; from deepir.cli import main\nif __name__ == '__main__': sys.exit(main(sys.argv[1:]))\n"
    Path("program.py").write_text(program)
    given = ["compare", "nuc", SMALL.replace("40, 48", "160, 192"), "seed=0,1,2,3", "--workers=2"]
    command = [sys.executable, "program.py", *given]
    process = subprocess.Popen(command, start_new_session=True, stderr=subprocess.PIPE, text=True)
    while not [*folder.rglob("metrics.json")]:
        time.sleep(0.05)
    os.killpg(process.pid, signal.SIGINT)  # as a terminal does
    err = process.communicate(timeout=60)[1]
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "interrupted" in err
    assert 1 <= len([*folder.rglob("metrics.json")]) < 4
    assert deepir(*given)[0] == 0
    assert len([*folder.rglob("metrics.json")]) == 4
