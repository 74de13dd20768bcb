"""Quality against the number of frames, and against seconds."""

from __future__ import annotations

import io
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from deepir.io import atomic_file
from deepir.paths import printable
from deepir.sweep.axes import BURST_AXIS, REPEAT_AXES
from deepir.sweep.table import TABLE_METRICS, Group, Row, group_rows, shown_metrics

FRAMES_AXIS = "data.frames"  # key of the axis of frame counts
AVERAGED_AXES = (*REPEAT_AXES, BURST_AXIS)  # axes over which curves take medians


def write_plots(path: Path, found: Sequence[Row]) -> None:
    """Write one picture, a line for each combination of the axes beside frames and repeats; none for a single point.

    Points are medians over seeds and bursts, with bars from the least to the greatest.
    """
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure
    from matplotlib.ticker import LogLocator, NullFormatter

    metric = shown_metrics(found)[0]
    finished, against = plottable(found)
    if not against:
        path.unlink(missing_ok=True)
        return
    figure = Figure(figsize=(6 * len(against), 4.5), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    lines = curves(finished)
    for axes, x in zip(figure.subplots(1, len(against), squeeze=False)[0], against, strict=True):
        for label, groups in lines.items():
            _draw(axes, groups, x, metric, printable(label).replace("$", r"\$"))  # a name is no formula
        axes.set(xlabel=x, ylabel=TABLE_METRICS[metric][0])
        axes.grid(alpha=0.3)
        if x == "seconds":
            axes.set_xscale("log")
            axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            axes.xaxis.set_minor_formatter(NullFormatter())
            axes.xaxis.set_major_formatter("{x:g}")
        else:
            axes.set_xticks(sorted({row.metrics["frames"] for row in finished}))
    if len(lines) > 1 and len(lines) <= 20:
        figure.legend(*axes.get_legend_handles_labels(), loc="outside right upper", fontsize=8)
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png", dpi=110)
    with atomic_file(path) as part:
        part.write_bytes(buffer.getvalue())


def plottable(found: Sequence[Row]) -> tuple[list[Row], list[str]]:
    """Rows that can be plotted, and against which quantities; none if they make a single point."""
    finished = [row for row in found if row.metrics.get(shown_metrics(found)[0]) is not None]
    if not finished or len(group_rows(finished, AVERAGED_AXES)) < 2:
        return finished, []
    several = len({row.metrics["frames"] for row in finished}) > 1
    return finished, ["frames", "seconds"] if several else ["seconds"]


def curves(found: Sequence[Row]) -> dict[str, list[Group]]:
    """Groups that differ only in the number of frames, by their common values."""
    lines: dict[str, list[Group]] = {}
    for group in group_rows(found, AVERAGED_AXES):
        label = ", ".join(value for key, value in group.values.items() if key != FRAMES_AXIS)
        lines.setdefault(label, []).append(group)
    return lines


def _draw(axes: Any, groups: Sequence[Group], x: str, metric: str, label: str) -> None:
    """A line through the medians, with bars from the least to the greatest."""
    ordered = sorted(groups, key=lambda group: group.median_range("frames") or ())
    (across, aside), (up, beside) = (
        _bars([group.median_range(each) for group in ordered]) for each in (x, metric)
    )
    axes.errorbar(
        across, up, xerr=aside, yerr=beside, marker="o", markersize=4, capsize=2, linewidth=1, label=label
    )


def _bars(spreads: Sequence[Any]) -> tuple[list[float], list[list[float]]]:
    """Medians, and distances to the least and the greatest."""
    middles = [middle for middle, _, _ in spreads]
    return middles, [
        [middle - least for middle, least, _ in spreads],
        [most - middle for middle, _, most in spreads],
    ]
