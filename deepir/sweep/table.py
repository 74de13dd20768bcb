"""The results of a sweep as tables, plots and a page."""

from __future__ import annotations

import csv
import io
import itertools
import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import Any
from urllib.parse import quote

import numpy as np
from PIL import Image

from deepir.arrays import Array
from deepir.errors import ConfigError
from deepir.paths import printable
from deepir.report.drawing import COLOURS, Axes, Scale, write_figure
from deepir.report.html import write_page
from deepir.sweep.cells import BURST_AXIS, REPEAT_AXES, SWEEP_FILES, Cell

Spread = tuple[float, float, float]  # median, least and greatest

FRAMES_AXIS = "data.frames"  # key of the axis of frame counts
PLOT_SIZE = 640, 440  # px
MAX_LEGEND = 20  # lines that are named
LEGEND_ROW = 0.06  # of the range of values, for the name of each line
MARGIN = 0.08  # of the range of values, beyond it
AVERAGED_AXES = (*REPEAT_AXES, BURST_AXIS)  # axes over which curves take medians
#: Metrics of `metrics.json` in the table: heading and decimals (None: three digits). `table.csv` has all.
TABLE_METRICS = {
    "psnr_aligned": ("PSNR (dB)", 2),
    "radiometric_rmse": ("radiometric error", None),
    "held_out_rmse": ("held-out error", None),
    "seconds": ("seconds", None),
}
FORMULA_SIGNS = ("=", "+", "-", "@")  # with which a spreadsheet begins a formula
#: First line of table.md, by which it is recognised.
TABLE_HEADER = "<!-- deepir: written by `deepir compare` or `deepir batch` -->\n"


def write_plots(path: Path, found: Sequence[Row]) -> None:
    """Write one picture, a line for each combination of the axes beside frames and repeats; none for a single point.

    Points are medians over seeds and bursts, with bars from the least to the greatest.
    """
    metric = shown_metrics(found)[0]
    finished, against = plottable(found)
    if not against:
        path.unlink(missing_ok=True)
        return
    write_figure(path, [[_plot(finished, x, metric, legend=x == against[-1]) for x in against]])


def _plot(found: Sequence[Row], x: str, metric: str, *, legend: bool) -> Image.Image:
    """A metric against another: lines through the medians, with bars from the least to the greatest."""
    lines = curves(found, x, metric)
    spreads = {label: np.reshape(points, (-1, 2, 3)) for label, points in lines.items()}
    everything = np.concatenate(list(spreads.values()))
    up = _scale(everything[:, 1], log=False)
    if few := 1 < len(lines) <= MAX_LEGEND:
        up = Scale(up.low, up.high + LEGEND_ROW * len(lines) * (up.high - up.low))
    axes = Axes(PLOT_SIZE, TABLE_METRICS[metric][0], _scale(everything[:, 0], log=x == "seconds"), up, x)
    for (label, points), colour in zip(spreads.items(), itertools.cycle(COLOURS)):
        middles = points[:, :, 0]
        axes.line(middles[:, 0], middles[:, 1], colour, printable(label) if legend and few else "", dots=True)
        for (at, height), (wide, tall) in zip(middles, points[:, :, 1:], strict=True):
            axes.line(wide, np.full(2, height), colour)
            axes.line(np.full(2, at), tall, colour)
    return axes.picture()


def _scale(values: Array, *, log: bool) -> Scale:
    """From the least to the greatest value, with a margin."""
    low, high = float(values.min()), float(values.max())
    if log:
        return Scale(max(low, 1e-3) / (1 + MARGIN), max(high, 1e-3) * (1 + MARGIN), log=True)
    margin = MARGIN * (high - low) or 0.5
    return Scale(low - margin, high + margin)


def plottable(found: Sequence[Row]) -> tuple[list[Row], list[str]]:
    """Rows that can be plotted, and against which quantities; none if they make a single point."""
    finished = [row for row in found if row.metrics.get(shown_metrics(found)[0]) is not None]
    if not finished or len(group_rows(finished, AVERAGED_AXES)) < 2:
        return finished, []
    several = len({row.metrics["frames"] for row in finished}) > 1
    return finished, ["frames", "seconds"] if several else ["seconds"]


def curves(found: Sequence[Row], x: str, metric: str) -> dict[str, list[tuple[Spread, Spread]]]:
    """Points of a metric against another, in the order of x; one curve where only the number of frames differs."""
    lines: dict[str, list[tuple[Spread, Spread]]] = {}
    for group in group_rows(found, AVERAGED_AXES):
        label = ", ".join(value for key, value in group.values.items() if key != FRAMES_AXIS)
        points, across, up = lines.setdefault(label, []), group.median_range(x), group.median_range(metric)
        if across and up:
            points.append((across, up))
    return {label: sorted(points) for label, points in lines.items()}


def write_report(path: Path, found: Sequence[Row], title: str) -> None:
    """Write the page beside the folders of the runs; `title` is the command."""
    groups, metrics = group_rows(found), shown_metrics(found)
    finished, against = plottable(found)
    data = {
        "title": printable(title),
        "axes": list(groups[0].values),
        "metrics": [{"name": TABLE_METRICS[each][0], "decimals": TABLE_METRICS[each][1]} for each in metrics],
        "rows": [
            {
                "values": [printable(each) for each in group.values.values()],
                "spreads": [group.median_range(metric) for metric in metrics],
                "runs": [_run(path.parent, row) for row in group.rows],
            }
            for group in groups
        ],
        "most": metrics[0] == "psnr_aligned",  # the first metric is best where it is greatest; others: least
        "curves": {
            x: [
                {"name": name, "points": [(across[0], *up) for across, up in points]}
                for name, points in curves(finished, x, metrics[0]).items()
            ]
            for x in against
        },
    }
    write_page(path, "sweep.html", ("plots.js", "sweep.js"), data)


def _run(folder: Path, row: Row) -> dict[str, Any]:
    """A run, with a link to its report if there is one."""
    report = folder / row.name / "report.html"
    link = f"{quote(row.name)}/report.html" if report.is_file() else None
    return {"name": row.name, "link": link, "done": bool(row.metrics), "error": printable(row.error)}


@dataclass(frozen=True)
class Row:
    """A cell's values by axis, its metrics (empty if it is not finished), and its error."""

    name: str
    values: Mapping[str, str]
    metrics: Mapping[str, Any]
    error: str = ""


@dataclass(frozen=True)
class Group:
    """Cells that differ only in seeds."""

    values: Mapping[str, str]
    rows: Sequence[Row]

    def median_range(self, metric: str) -> Spread | None:
        """Median, least and greatest of a metric over the cells that have it; None if none has."""
        found = [row.metrics[metric] for row in self.rows if row.metrics.get(metric) is not None]
        return (median(found), min(found), max(found)) if found else None


def make_rows(cells: Sequence[Cell], errors: Mapping[str, str]) -> list[Row]:
    """A row for each cell.

    Args:
        cells: The cells.
        errors: Errors by the cells' names.
    """
    return [Row(cell.name, cell.values, _metrics(cell), errors.get(cell.name, "")) for cell in cells]


def group_rows(found: Sequence[Row], without: Sequence[str] = REPEAT_AXES) -> list[Group]:
    """Rows grouped by their values, except for those of the axes `without`, in order."""
    groups: dict[tuple[str, ...], list[Row]] = {}
    keys = [key for key in found[0].values if key not in without]
    for row in found:
        groups.setdefault(tuple(row.values[key] for key in keys), []).append(row)
    return [Group(dict(zip(keys, values, strict=True)), each) for values, each in groups.items()]


def shown_metrics(found: Sequence[Row]) -> list[str]:
    """Metrics of the table: the held-out error only where there is no truth."""
    truth = any("psnr_aligned" in row.metrics for row in found)
    unknown = ("held_out_rmse",) if truth else ("psnr_aligned", "radiometric_rmse")
    return [metric for metric in TABLE_METRICS if metric not in unknown]


def table_lines(found: Sequence[Row]) -> tuple[list[str], list[list[str]]]:
    """Headings and cells of the table: a line for each group, medians with the least and the greatest."""
    groups, metrics = group_rows(found), shown_metrics(found)
    heads = [*groups[0].values, "finished", *(TABLE_METRICS[metric][0] for metric in metrics)]
    body = []
    for group in groups:
        done = sum(bool(row.metrics) for row in group.rows)
        figures = [_figure(group.median_range(metric), TABLE_METRICS[metric][1]) for metric in metrics]
        body.append([*group.values.values(), f"{done}/{len(group.rows)}", *figures])
    return heads, body


def metrics_line(cell: Cell) -> str:
    """The metrics of one cell in a line."""
    found = make_rows([cell], {})
    heads, (body,) = table_lines(found)
    pairs = list(zip(heads, body, strict=True))[-len(shown_metrics(found)) :]
    return ", ".join(f"{head} {each}" for head, each in pairs)


def markdown(found: Sequence[Row], title: str) -> str:
    """The table as a page, with its machines and failures."""
    heads, body = table_lines(found)
    body = [[printable(cell) for cell in line] for line in body]
    table = [heads, ["---"] * len(heads), *([cell.replace("|", "\\|") for cell in line] for line in body)]
    text = "".join(f"| {' | '.join(line)} |\n" for line in table)
    repeated = any(len(group.rows) > 1 for group in group_rows(found))
    note = "Medians over seeds, with the least and the greatest.\n\n" if repeated else ""
    ran = sorted({str(row.metrics["machine"]) for row in found if "machine" in row.metrics})
    where = "".join(f"\nOn {each}.\n" for each in ran)
    failed = "".join(f"- `{row.name}`: {printable(row.error)}\n" for row in found if row.error)
    return f"{TABLE_HEADER}# Results\n\n`{printable(title)}`\n\n{note}{text}{where}" + (
        f"\nFailed:\n\n{failed}" if failed else ""
    )


def csv_table(found: Sequence[Row]) -> str:
    """A line for each cell, with all its numbers; no text is a formula to a spreadsheet."""
    names = {
        name: None
        for row in found
        for name, value in row.metrics.items()
        if isinstance(value, int | float | str) and name not in row.values
    }
    stream = io.StringIO()
    writer = csv.DictWriter(stream, [*found[0].values, *names, "error"], extrasaction="ignore", lineterminator="\n")
    writer.writeheader()
    for row in found:
        cells = {**row.metrics, **row.values, "error": row.error}
        writer.writerow({name: _inert(cell) for name, cell in cells.items()})
    return stream.getvalue()


def check_free(folder: Path) -> None:
    """Check that a table may be written.

    Raises:
        ConfigError: The folder holds a table that no sweep wrote.
    """
    page = folder / "table.md"
    try:
        ours = page.is_file() and page.read_text(encoding="utf-8").startswith(TABLE_HEADER)
    except (OSError, UnicodeDecodeError):
        ours = False
    for name in SWEEP_FILES:
        if not ours and (folder / name).exists():
            raise ConfigError(
                f"output.dir: {folder} holds {name}, which no comparison wrote; give another folder with output.dir=DIR"
            )


def _inert(cell: Any) -> Any:
    """A cell of a CSV file; text that a spreadsheet would take for a formula gets an apostrophe in front."""
    if not isinstance(cell, str):
        return cell
    text = printable(cell)
    if not text.startswith(FORMULA_SIGNS):
        return text
    try:
        float(text)
    except ValueError:
        return f"'{text}"
    return text


def _metrics(cell: Cell) -> dict[str, Any]:
    """Metrics of a finished cell; none if they are damaged, and null for a figure that is no number."""
    if cell.folder.state() != "finished":
        return {}
    try:
        found = json.loads((cell.folder.path / "metrics.json").read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError):
        return {}
    if not isinstance(found, dict) or not isinstance(found.get("frames"), int):
        return {}
    numbers = {name: found[name] for name in TABLE_METRICS if isinstance(found.get(name), int | float)}
    return found | dict.fromkeys(TABLE_METRICS.keys() & found.keys()) | numbers


def _figure(spread: Spread | None, decimals: int | None) -> str:
    if spread is None:
        return "–"
    middle, least, most = (f"{each:.3g}" if decimals is None else f"{each:.{decimals}f}" for each in spread)
    return middle if least == most else f"{middle} ({least} to {most})"
