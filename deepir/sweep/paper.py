"""A sweep as a paper shows it: a LaTeX table, all figures as a long CSV, and pictures of scenes and errors."""

from __future__ import annotations

import csv
import importlib.util
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from deepir.arrays import Array
from deepir.config import load
from deepir.io.output import atomic_file, write_text
from deepir.io.tone_mapping import SIGNED, WHITE_HOT
from deepir.metrics import align
from deepir.paths import printable
from deepir.report.drawing import composed, draw_map
from deepir.runner import prepare
from deepir.sweep.cells import BURST_AXIS, REPEAT_AXES, Cell
from deepir.sweep.table import Group, Row, group_rows

#: Metric -> heading, decimals, and whether more is better; None: neither.
METRICS: dict[str, tuple[str, int, bool | None]] = {
    "psnr_aligned": ("PSNR (dB)", 2, True),
    "ssim_aligned": ("SSIM", 3, True),
    "lpips": ("LPIPS", 3, False),
    "held_out_rmse": ("held-out error", 3, False),
    "seconds": ("time (s)", 2, None),
    "parameters": ("parameters", 0, None),
}
REPEATS = (*REPEAT_AXES, BURST_AXIS, "data.path")  # axes over which means are taken
CLEAR = 2.0  # standard errors of the mean of paired differences, from which one method is worse than another
PICTURE = 260, 220  # px
LATEX = {"\\": r"\textbackslash{}", **{sign: f"\\{sign}" for sign in "&%$#_{}"}, "~": r"\textasciitilde{}"}


def write_paper(folder: Path, cells: Sequence[Cell], found: Sequence[Row]) -> None:
    """Write `paper.tex`, `paper.csv` and, where runs have a truth, `paper.pdf`."""
    finished = [_with_lpips(cell, row) for cell, row in zip(cells, found, strict=True) if row.metrics]
    if not finished:
        return
    write_text(folder / "paper.tex", latex(finished))
    write_text(folder / "paper.csv", long_csv(finished))
    pictures = panels([cell for cell, row in zip(cells, found, strict=True) if row.metrics])
    if pictures:
        with atomic_file(folder / "paper.pdf") as part:
            composed(pictures).save(part, format="PDF", resolution=200)


def latex(found: Sequence[Row]) -> str:
    """The table: means and standard deviations over seeds and bursts, of each combination of the other settings.

    What is not clearly worse than the best is bold, by the paired differences of the same seeds and bursts; without
    repeats nothing is.
    """
    groups = group_rows(found, REPEATS)
    shown = [name for name in METRICS if any(row.metrics.get(name) is not None for row in found)]
    heads = [*groups[0].values, *(METRICS[name][0] for name in shown)]
    best = {name: _not_worse(groups, name) for name in shown}
    lines = []
    for k, group in enumerate(groups):
        cells = [_escaped(value) for value in group.values.values()]
        lines.append([*cells, *(_cell(group, name, bold=k in best[name]) for name in shown)])
    count = len(groups[0].rows)
    columns = "l" * len(groups[0].values) + "r" * len(shown)
    return "\n".join(
        [
            f"% Means and standard deviations over {count} runs each. Bold: not worse than the best by more than",
            f"% {CLEAR:g} standard errors of the paired differences. Needs \\usepackage{{booktabs}}.",
            f"\\begin{{tabular}}{{{columns}}}",
            "\\toprule",
            " & ".join(map(_escaped, heads)) + r" \\",
            "\\midrule",
            *(" & ".join(line) + r" \\" for line in lines),
            "\\bottomrule",
            "\\end{tabular}",
            "",
        ]
    )


def long_csv(found: Sequence[Row]) -> str:
    """A line for each run and metric: the settings, the metric's name, its value."""
    stream = io.StringIO()
    writer = csv.writer(stream, lineterminator="\n")
    writer.writerow([*found[0].values, "metric", "value"])
    for row in found:
        for name, value in row.metrics.items():
            if isinstance(value, int | float) and not isinstance(value, bool):
                writer.writerow([*map(printable, row.values.values()), name, value])
    return stream.getvalue()


def panels(cells: Sequence[Cell]) -> list[list[Image.Image]]:
    """For the first burst and seed a column for each method: its scene, and below it the error, all on one scale."""
    first = {key: value for key, value in cells[0].values.items() if key in REPEATS}
    chosen = [cell for cell in cells if all(cell.values[key] == value for key, value in first.items())]
    truth = _truth(chosen[0])
    scenes = [_scene(cell) for cell in chosen]
    if truth is None or any(scene.shape != truth.shape for scene in scenes):
        return []
    known = np.isfinite(truth)
    scenes = [align(scene, truth, known) for scene in scenes]
    errors = [np.where(known, scene - truth, 0) for scene in scenes]
    reach = float(np.quantile(np.abs(errors), 0.99)) or 1.0
    low, high = np.nanquantile(truth, (0.005, 0.995))
    apart = [[value for key, value in cell.values.items() if key not in REPEATS] for cell in chosen]
    names = ["truth", *(printable(", ".join(each)) for each in apart)]
    shown = [truth, *scenes]
    return [
        [draw_map(np.clip(each, low, high), name, WHITE_HOT, PICTURE) for each, name in zip(shown, names, strict=True)],
        [
            Image.new("RGB", PICTURE, "white"),
            *(draw_map(np.clip(each, -reach, reach), "error", SIGNED, PICTURE, centre=0.0) for each in errors),
        ],
    ]


def _not_worse(groups: Sequence[Group], name: str) -> set[int]:
    """Numbers of the groups that are not clearly worse than the best in a metric."""
    sign = {True: 1, False: -1, None: 0}[METRICS[name][2]]
    runs = [_by_repeat(group, name) for group in groups]
    shared = set.intersection(*(set(each) for each in runs))
    if not sign or len(groups) < 2 or len(shared) < 2:
        return set()
    values = sign * np.array([[each[key] for key in sorted(shared)] for each in runs])
    behind = values[values.mean(1).argmax()] - values
    errors = behind.std(1, ddof=1) / np.sqrt(len(shared))
    return set(np.flatnonzero(behind.mean(1) <= CLEAR * errors))


def _by_repeat(group: Group, name: str) -> dict[tuple[str, ...], float]:
    return {
        tuple(row.values[key] for key in row.values if key in REPEATS): float(row.metrics[name])
        for row in group.rows
        if row.metrics.get(name) is not None
    }


def _cell(group: Group, name: str, *, bold: bool) -> str:
    values = list(_by_repeat(group, name).values())
    if not values:
        return "--"
    decimals = METRICS[name][1]
    text = f"{np.mean(values):.{decimals}f}"
    if len(values) > 1 and name != "parameters":
        text += rf" \pm {np.std(values, ddof=1):.{decimals}f}"
    return rf"$\mathbf{{{text}}}$" if bold else f"${text}$"


def _escaped(text: str) -> str:
    return "".join(LATEX.get(letter, letter) for letter in printable(text))


def _scene(cell: Cell) -> Array:
    with np.load(cell.folder.path / "result.npz") as stored:
        return np.asarray(stored["scene"], float)


def _truth(cell: Cell) -> Array | None:
    """The true scene of a run, if its configuration has one of its scene's size."""
    scene = prepare(load(cell.folder.config)).truth.get("scene")
    return scene if scene is not None and np.ndim(scene) == 2 else None


def _with_lpips(cell: Cell, row: Row) -> Row:
    """The row with the perceptual distance to the truth, where the package lpips is installed."""
    if importlib.util.find_spec("lpips") is None or (truth := _truth(cell)) is None:
        return row
    import lpips
    import torch

    scene, known = _scene(cell), np.isfinite(truth)
    if scene.shape != truth.shape:
        return row
    low, span = float(truth[known].min()), float(np.ptp(truth[known])) or 1.0
    pair = [
        torch.from_numpy(2 * (np.where(known, each, low) - low) / span - 1).float().expand(1, 3, -1, -1)
        for each in (align(scene, truth, known), truth)
    ]
    with torch.no_grad():
        distance = float(lpips.LPIPS(net="alex", verbose=False)(*pair))
    metrics: Mapping[str, Any] = {**row.metrics, "lpips": distance}
    return Row(row.name, row.values, metrics, row.error)
