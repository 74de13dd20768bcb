"""Pictures of one burst by every method, from the worst to the best, as the benchmark's cells have it."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
from record_protocol import DEFAULT
from record_tables import FRAMES, QUALITY

from deepir.metrics import align
from deepir.report.panels import Panel, write_panels
from deepir.sweep.cells import BURST_AXIS, Cell
from deepir.sweep.table import make_rows

COLUMNS = 4
LEFT_OUT = ("oracle",)  # it is told nearly all


def write_methods(path: Path, cells: Sequence[Cell], burst: str, n: str) -> bool:
    """Panels of all methods that are finished; whether there are any."""
    wanted = [cell for cell in cells if (cell.values[BURST_AXIS], cell.values[FRAMES]) == (burst, n)]
    panels = list(_panels(wanted))
    if panels:
        write_panels(path, panels, rows=-(-len(panels) // COLUMNS))
    return bool(panels)


def _panels(cells: Sequence[Cell]) -> Iterator[Panel]:
    done = [(cell, row) for cell, row in zip(cells, make_rows(cells, {}), strict=True) if QUALITY in row.metrics]
    shown = [each for each in done if each[1].values["method"] not in LEFT_OUT]
    truth = None
    for cell, row in sorted(shown, key=lambda each: each[1].metrics[QUALITY]):
        with np.load(cell.folder.path / "result.npz") as stored:
            scene = stored["scene"].astype(float)
        with np.load(str(cell.config.data.truth)) as stored:
            truth = stored["scene"]
        method = row.values["method"]
        title = f"{'deepir (joint)' if method == DEFAULT else method}, {row.metrics[QUALITY]:.1f} dB"
        yield title, align(scene, truth, np.isfinite(truth)), *_ends(truth)
    if truth is not None:
        yield "truth", truth, *_ends(truth)


def _ends(truth: np.ndarray) -> tuple[float, float]:
    low, high = np.percentile(truth, [0.2, 99.8])
    return float(low), float(high)
