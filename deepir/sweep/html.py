"""`report.html` of a sweep: a sortable table with curves and links to the reports of its runs."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any
from urllib.parse import quote

from deepir.paths import printable
from deepir.report.page import write_page
from deepir.sweep.plots import curves, plottable
from deepir.sweep.table import TABLE_METRICS, Group, Row, group_rows, shown_metrics


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
        "curves": {x: _curves(curves(finished), x, metrics[0]) for x in against},
    }
    write_page(path, "sweep.html", ("plots.js", "sweep.js"), data)


def _run(folder: Path, row: Row) -> dict[str, Any]:
    """A run, with a link to its report if there is one."""
    report = folder / row.name / "report.html"
    link = f"{quote(row.name)}/report.html" if report.is_file() else None
    return {"name": row.name, "link": link, "done": bool(row.metrics), "error": printable(row.error)}


def _curves(lines: dict[str, list[Group]], x: str, metric: str) -> list[dict[str, Any]]:
    """Name, and (x, median, least, greatest) of each point, of each line."""
    found = []
    for name, groups in lines.items():
        points = [
            (across[0], *up)
            for group in groups
            if (across := group.median_range(x)) and (up := group.median_range(metric))
        ]
        found.append({"name": name, "points": sorted(points)})
    return found
