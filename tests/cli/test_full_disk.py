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


@pytest.mark.parametrize(
    ("command", "size"),
    [
        ("simulate new.npz n_frames=3 shape=[40,48]", 50_000),
        ("simulate burst.npz n_frames=3 shape=[40,48] --overwrite", 50_000),
        ("apply maps.npz noise.npz --output film.mp4 --overwrite", 30_000),
        ("apply maps.npz noise.npz --output film.tif --overwrite", 30_000),
        ("calibrate found.npz noise.npz", 4_000),
    ],
)
def test_what_cannot_be_written_leaves_the_former_file_or_none(deepir, folder, full_disk, command, size):
    if "mp4" in command:
        pytest.importorskip("av")
    shape = (64, 80)
    np.savez("noise.npz", frames=np.random.default_rng(0).normal(8000, 200, (40, *shape)).astype(np.float32))
    np.savez("maps.npz", gain=np.ones(shape), offset=np.zeros(shape), bad_pixels=np.zeros(shape, bool))
    for name in ("film.mp4", "film.tif"):
        (folder / name).write_bytes(b"former")
    before = contents(folder)
    with full_disk(size):
        status, out, err = deepir(*command.split())
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "cannot be written: File too large" in err
    assert contents(folder) == before
    assert deepir(*command.split())[0] == 0
