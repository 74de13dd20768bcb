"""Tables of the figures of corrected recordings: for each family and method, how many are made worse, and how good."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]  # family, name, seed, method, status, seconds, and figures

#: Above this share of what was there, and below the raw likeness by more than this, a recording is made worse.
WORSE_PATTERN, WORSE_LIKENESS = 1.01, 0.001
#: Largest low-order part, over the scene's deviation, that may be taken off a camera that is corrected already.
WORSE_TAKEN = 0.05
WITHOUT_TRUTH = "corrected"


def summary(rows: Sequence[Row]) -> Iterator[str]:
    """A table for each family, its methods in the order of the rows."""
    for family in dict.fromkeys(row["family"] for row in rows):
        of_family = [row for row in rows if row["family"] == family]
        recordings = {(row["name"], row["seed"]) for row in of_family}
        yield f"\n## {family}: {len(recordings)} recordings\n"
        if family == WITHOUT_TRUTH:
            yield "| method | refused | low > 5 % | low | fine | unevenness | bad pixels, % | s | CPU s |"
            yield "|---|---|---|---|---|---|---|---|---|"
        else:
            yield (
                "| method | refused | worse: low | fine | likeness | low | fine | likeness | raw likeness | "
                "bad, false, % | s | CPU s |"
            )
            yield "|---|---|---|---|---|---|---|---|---|---|---|---|"
        for method in dict.fromkeys(row["method"] for row in of_family):
            yield _summary_row(method, [row for row in of_family if row["method"] == method])


def _summary_row(method: str, rows: Sequence[Row]) -> str:
    found = [row for row in rows if row["status"] == "done"]
    failed = sum(row["status"].startswith("failed") for row in rows)
    refused = f"{len(rows) - len(found)}" + (f" ({failed} failed)" if failed else "")
    if not found:
        return f"| {method} | {refused} |"
    seconds = [_median(found, key, ".2g") for key in ("seconds", "CPU seconds")]
    if "unevenness" in found[0]:
        cells = [str(sum(row["low"] > WORSE_TAKEN for row in found))]
        cells += [_spread(found, key, max) for key in ("low", "fine", "unevenness")]
        cells += [_spread(found, "bad", max, 100)]
    else:
        cells = [str(sum(row[part] > WORSE_PATTERN for row in found)) for part in ("low", "fine")]
        cells += [str(sum(row["likeness"] < row["raw likeness"] - WORSE_LIKENESS for row in found))]
        cells += [_spread(found, "low", max), _spread(found, "fine", max), _spread(found, "likeness", min)]
        cells += [_median(found, "raw likeness", ".3f"), _spread(found, "bad, false", max, 100)]
    return f"| {method} | {refused} | {' | '.join(cells + seconds)} |"


def _values(rows: Sequence[Row], key: str) -> list[float]:
    return [row[key] for row in rows if key in row and np.isfinite(row[key])]


def _median(rows: Sequence[Row], key: str, form: str) -> str:
    values = _values(rows, key)
    return format(float(np.median(values)), form) if values else ""


def _spread(rows: Sequence[Row], key: str, worst: Any, factor: float = 1.0) -> str:
    """Median, and in brackets the worst."""
    values = [factor * value for value in _values(rows, key)]
    return f"{np.median(values):.3f} ({worst(values):.2f})" if values else ""


def each(rows: Sequence[Row]) -> Iterator[str]:
    """A line for each recording and method."""
    for row in rows:
        yield line(row)


def line(row: Row) -> str:
    figures = [f"{key} {row[key]:.3f}" for key in ("low", "fine") if key in row]
    if "likeness" in row:
        figures.append(f"likeness {row['raw likeness']:.3f} to {row['likeness']:.3f}")
    for key in ("unevenness", "bad", "bad, false", "bad, found", "covers 68", "covers 95", "sigmas"):
        figures += [f"{key} {row[key]:.4g}"] if key in row else []
    what = f"{row['family']} {row['seed']}: {row['name']}: {row['method']}"
    if row["status"] != "done":
        return f"{what}: {row['status']}"
    return (
        f"{what}: {', '.join(figures)}; {row['seconds']:.2f} s, CPU {row['CPU seconds']:.2f} s; {row['kept']}"
    )
