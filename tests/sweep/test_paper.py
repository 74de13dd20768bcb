"""What a sweep gives to a paper."""

import csv
import io

import numpy as np
import pytest

from deepir.report.drawing import composed
from deepir.simulate import Settings, simulate
from deepir.sweep import paper
from deepir.sweep.cells import parse_axes
from deepir.sweep.cluster import finish_cell
from deepir.sweep.sweep import prepare
from deepir.sweep.table import Row


def row(prior, seed, psnr):
    metrics = {"psnr_aligned": psnr, "seconds": 2.0, "parameters": 10, "method": "joint"}
    return Row(f"{prior}{seed}", {"prior": prior, "seed": str(seed)}, metrics)


def cells_of(table, prior):
    line = next(line for line in table.splitlines() if line.startswith(f"{prior} &"))
    return [cell.strip() for cell in line.removesuffix(r" \\").split("&")]


def test_means_and_deviations_are_those_of_the_seeds():
    table = paper.latex([row("tv", seed, psnr) for seed, psnr in enumerate((30.0, 31.0, 32.0))])
    assert cells_of(table, "tv") == ["tv", r"$31.00 \pm 1.00$", r"$2.00 \pm 0.00$", "$10$"]
    assert r"prior & PSNR (dB) & time (s) & parameters \\" in table


def test_a_difference_below_its_error_is_no_victory():
    base = [25.0, 31.0, 38.0, 29.0]
    rows = [row("best", k, psnr) for k, psnr in enumerate(base)]
    rows += [row("equal", k, psnr - d) for k, (psnr, d) in enumerate(zip(base, (0.3, -0.2, 0.2, -0.1), strict=True))]
    rows += [row("worse", k, psnr - d) for k, (psnr, d) in enumerate(zip(base, (0.3, 0.2, 0.3, 0.2), strict=True))]
    bold = {name: r"\mathbf" in cells_of(paper.latex(rows), name)[1] for name in ("best", "equal", "worse")}
    assert bold == {"best": True, "equal": True, "worse": False}
    assert r"\mathbf" not in paper.latex([each for each in rows if each.values["seed"] == "0"])


def test_signs_of_latex_are_escaped():
    assert r"a\_b\%\{\} & " in paper.latex([row("a_b%{}", 0, 30.0), row("c", 0, 30.0)])


def test_the_long_form_has_a_line_for_each_figure():
    lines = list(csv.DictReader(io.StringIO(paper.long_csv([row("tv", 0, 30.0), row("foe", 0, 31.5)]))))
    assert {"prior": "foe", "seed": "0", "metric": "psnr_aligned", "value": "31.5"} in lines
    assert {line["metric"] for line in lines} == {"psnr_aligned", "seconds", "parameters"}


@pytest.fixture
def swept(tmp_path, monkeypatch):
    """Two priors and two seeds on a simulated burst, a few iterations each."""
    monkeypatch.chdir(tmp_path)
    burst = simulate(settings=Settings(shape=(40, 48), n_frames=3), seed=1)
    np.savez("burst.npz", frames=burst.frames)
    np.savez("truth.npz", scene=burst.truth.scene)
    settings = ["data.path=burst.npz", "data.truth=truth.npz", "solver.max_iterations=2", "threads=1"]
    fixed, axes = parse_axes([*settings, "prior=tv,red", "seed=0,1"])
    with prepare("nuc", fixed, axes, folder=tmp_path / "out", workers=1, remote=False, overwrite=False) as sweep:
        for cell in sweep.cells:
            assert finish_cell(cell, ()) is None
        yield sweep


def test_the_files_of_a_paper_show_scenes_and_errors(swept):
    swept.write("deepir compare", paper=True)
    assert (swept.folder / "paper.pdf").read_bytes().startswith(b"%PDF")
    assert cells_of((swept.folder / "paper.tex").read_text(), "red")[-1] == "$4608$"
    picture = composed(paper.panels(swept.cells))
    assert picture.size == (3 * paper.PICTURE[0], 2 * paper.PICTURE[1])
