"""A full disk: status 2 and one line, no half file, and a former result that is whole."""

import numpy as np
import pytest


def contents(folder):
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def test_a_run_that_cannot_be_written_leaves_the_former_one_and_goes_on(nuc, deepir, folder, full_disk):
    nuc("data.path=burst.npz", "seed=1")
    before = contents(folder / "runs/nuc")
    with full_disk(12_000):
        status, _, err = nuc("data.path=burst.npz", "seed=2", "--overwrite")
    assert status == 2
    assert err.splitlines()[-1].startswith("deepir: error: ")
    assert "the former result is kept, and the new run can go on: deepir resume runs/nuc" in err
    assert "Traceback" not in err
    assert contents(folder / "runs/nuc") == before
    assert not list(folder.rglob("*.npz.*"))
    assert deepir("resume", "runs/nuc")[0] == 0
    assert "seed: 2" in (folder / "runs/nuc/config.yaml").read_text()
    assert {path.name for path in (folder / "runs/nuc").iterdir()} == before.keys()


def test_a_comparison_that_cannot_be_written_leaves_the_former_one(deepir, folder, full_disk, monkeypatch):
    pytest.importorskip("distributed")
    from deepir.sweep.cluster import finish_cell

    monkeypatch.setattr(
        "deepir.sweep.cluster.run_cells", lambda cells, **_: [(cell, finish_cell(cell)) for cell in cells]
    )
    command = ("compare", "nuc", "data.path=burst.npz", "threads=1", "seed=0,1", "method=average")
    assert deepir(*command)[0] == 0
    before = contents(folder / "runs/nuc-compare/seed=0")
    with full_disk(12_000):
        assert deepir(*command, "noise.read=3", "--overwrite")[0] != 0
    assert contents(folder / "runs/nuc-compare/seed=0") == before
    assert deepir(*command, "noise.read=3")[0] == 0
    assert "read: 3" in (folder / "runs/nuc-compare/seed=0/config.yaml").read_text()


def test_a_simulation_that_cannot_be_written_leaves_nothing(deepir, folder, full_disk):
    before = contents(folder)
    with full_disk(50_000):
        status, _, err = deepir("simulate", "new.npz", "n_frames=3", "shape=[40,48]")
        again = deepir("simulate", "burst.npz", "n_frames=3", "shape=[40,48]", "--overwrite")
    assert (status, again[0]) == (2, 2)
    assert "cannot be written: File too large" in err
    assert contents(folder) == before


@pytest.mark.parametrize("output", ["film.mp4", "film.tif"])
def test_a_recording_that_cannot_be_written_leaves_the_former_one(deepir, folder, full_disk, output):
    if output.endswith(".mp4"):
        pytest.importorskip("av")
    frames = np.random.default_rng(0).normal(8000, 200, (40, 64, 80)).astype(np.float32)
    np.savez("noise.npz", frames=frames)
    np.savez(
        "maps.npz", gain=np.ones((64, 80)), offset=np.zeros((64, 80)), bad_pixels=np.zeros((64, 80), bool)
    )
    (folder / output).write_bytes(b"former")
    before = contents(folder)
    command = ("apply", "maps.npz", "noise.npz", "--output", output, "--overwrite")
    with full_disk(30_000):
        status, out, err = deepir(*command)
    assert (status, out) == (2, "")
    assert f"{output}: cannot be written: File too large" in err
    assert err.count("\n") == 1
    assert contents(folder) == before
    assert deepir(*command)[0] == 0


def test_maps_that_cannot_be_written_leave_nothing(deepir, folder, full_disk):
    np.savez("flat.npz", frames=np.random.default_rng(0).normal(8000, 20, (12, 40, 48)).astype(np.float32))
    before = contents(folder)
    with full_disk(4_000):
        status, _, err = deepir("calibrate", "maps.npz", "flat.npz")
    assert status == 2
    assert "maps.npz: cannot be written: File too large" in err
    assert contents(folder) == before
