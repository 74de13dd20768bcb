"""Tables of the figures of corrected recordings: for each family and method, how many are made worse, and how good."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Any

import numpy as np

Row = dict[str, Any]  # family, name, seed, method, status, kept, and figures

#: Share of the pattern, above which a recording is made worse; and loss of likeness from which it is.
WORSE_PATTERN, WORSE_LIKENESS = 1.01, 0.001
#: Low-order part, over the scene's deviation, from which too much is taken off a camera that is corrected already.
WORSE_TAKEN = 0.05
OURS = "correct"
ABOUT = {
    "hand-held": "Windows of real pictures, moved by hand, under drawn patterns.",
    "large": "Pictures of 240 to 512 rows, by pans, scans and hand, under drawn patterns; levels drift.",
    "agc": "As hand-held, each frame stretched to 8 bits by a gain control. The truth is what a camera without a "
    "pattern shows, cut off at 0 and 255 too. **Limit**: what the true pattern, taken off, leaves of clipped samples.",
    "drive": "Pieces of a real drive, half as fine, under drawn patterns.",
    "simulated": "240 frames of 320 x 240 px: drive, walk, pan, drone; raw, shaded, after a shutter, lossy.",
    "real": "A drive with an uncooled Lynred camera, whole and in pieces. Likeness is that with calibrated frames.",
    "corrected": "Films that their makers have corrected. What is taken off is relative to the scene's deviation.",
}
INTRODUCTION = """# Whole recordings

`make bench-recordings`. Figures are medians, with the worst in brackets. **Low** and **fine**: what is left of the
low-order and of the fine pattern, over what was there. One is nothing done, and more is harm. **Likeness**: median
correlation of corrected with true frames. `worse`: recordings with more low-order pattern, more fine pattern, or less
likeness than the raw ones. A method that refuses a recording leaves it as it is; only the others count.

**Limit**: the Cramér-Rao limit of low, at known displacements, of an offset whose cells of 8 px are all free. Methods
that expect a smooth offset can be better. `nuc` and `flow` take ten frames of one place, `multiview_nuc` ten of the
whole recording. Rivals have their defaults."""
CORRECTED = """**Unevenness**: 90th percentile over median of the detail's deviation in blocks. A sensor's is about 1.3,
that of a scene's edges more. **Kept**: fine and slow pattern that held-out frames keep, over the raw one.

A dark spot of the optics is left in the films of `tensoristd`: what is taken off four of them, each of another scene,
correlates by 0.96 to 1.00 (`benchmarks/same_optics.py`).
"""
#: Heading and contents of the columns: of films with a truth, and of cameras that are corrected already.
Column = tuple[str, Callable[[Sequence[Row]], str]]


def page(rows: Sequence[Row]) -> Iterator[str]:
    """Lines of markdown."""
    yield INTRODUCTION
    yield from summary(rows)


def summary(rows: Sequence[Row]) -> Iterator[str]:
    """A table for each family, and who is best."""
    for family in dict.fromkeys(row["family"] for row in rows):
        some = [row for row in rows if row["family"] == family]
        count = len({(row["name"], row["seed"]) for row in some})
        seeds = ", ".join(map(str, sorted({row["seed"] for row in some})))
        title = family.upper() if family == "agc" else family.capitalize()
        yield f"\n## {title}: {count} recording{'s' if count > 1 else ''}, seeds {seeds}\n"
        yield f"{ABOUT[family]}\n"
        if family == "corrected":
            yield CORRECTED
        yield from _table(some, OF_CORRECTED if family == "corrected" else OF_TRUTH)
        if family != "corrected" and len({row["method"] for row in some}) > 1:
            yield f"\n{' '.join(winners(some))}"


def winners(rows: Sequence[Row]) -> Iterator[str]:
    """Sentences: the best median of each figure, and the methods ahead of `correct` where both found something."""
    found: dict[str, dict[tuple[str, int], Row]] = {}
    for row in rows:
        if row["status"] == "done":
            found.setdefault(row["method"], {})[row["name"], row["seed"]] = row
    for figure, sign in (("low", 1), ("fine", 1), ("likeness", -1)) if found else ():
        medians = {method: _median_of(some.values(), figure) for method, some in found.items()}
        best = min(medians, key=lambda method: sign * medians[method])
        ours = found.get(OURS, {})
        ahead = []
        for method, some in found.items():
            both = [each for each in some if each in ours]
            here, there = (_median_of([of[each] for each in both], figure) for of in (some, ours))
            if method != OURS and sign * here < sign * there:
                ahead.append(f"`{method}`")
        beside = f"; ahead of `{OURS}`: {', '.join(ahead)}" if ahead else ""
        yield f"Best {figure}: `{best}` ({medians[best]:.3f}){beside}."


def line(row: Row) -> str:
    """The figures of one method on one recording."""
    what = f"{row['family']} {row['seed']}: {row['name']}: {row['method']}"
    if row["status"] != "done":
        return f"{what}: {row['status']}"
    figures = {key: value for key, value in row.items() if isinstance(value, float)}
    seconds, cpu = figures.pop("seconds"), figures.pop("CPU seconds")
    before = figures.pop("raw likeness", None)
    shown = [f"{key} {value:.4g}" for key, value in figures.items()]
    shown += [] if before is None else [f"raw likeness {before:.4g}"]
    return f"{what}: {', '.join(shown)}; {seconds:.2f} s, CPU {cpu:.2f} s; {row['kept']}"


def _table(rows: Sequence[Row], columns: Sequence[Column]) -> Iterator[str]:
    yield f"| method | {' | '.join(name for name, _ in columns)} |"
    yield "|---|" + "---|" * len(columns)
    for method in dict.fromkeys(row["method"] for row in rows):
        some = [row for row in rows if row["method"] == method]
        found = [row for row in some if row["status"] == "done"]
        cells = [_refused(some), *(content(found) if found else "" for _, content in columns[1:])]
        yield f"| {method} | {' | '.join(cells)} |"


def _median_of(rows: Iterable[Row], figure: str) -> float:
    values = [row[figure] for row in rows]
    return float(np.median(values)) if values else float("nan")


def _refused(rows: Sequence[Row]) -> str:
    failed = sum(row["status"].startswith("failed") for row in rows)
    refused = sum(row["status"].startswith("refused") for row in rows)
    return str(refused) + (f", {failed} failed" if failed else "")


def _worse(rows: Sequence[Row]) -> str:
    pattern = [sum(row[part] > WORSE_PATTERN for row in rows) for part in ("low", "fine")]
    likeness = sum(row["likeness"] < row["raw likeness"] - WORSE_LIKENESS for row in rows)
    return f"{pattern[0]}, {pattern[1]}, {likeness} of {len(rows)}"


def _taken(rows: Sequence[Row]) -> str:
    return f"{sum(row['low'] > WORSE_TAKEN for row in rows)} of {len(rows)}"


def _values(rows: Sequence[Row], key: str) -> list[float]:
    return [row[key] for row in rows if np.isfinite(row.get(key, np.nan))]


def _median(key: str, form: str) -> Callable[[Sequence[Row]], str]:
    def cell(rows: Sequence[Row]) -> str:
        values = _values(rows, key)
        return format(float(np.median(values)), form) if values else ""

    return cell


def _spread(key: str, worst: Callable[[list[float]], float], factor: float = 1.0) -> Callable[..., str]:
    def cell(rows: Sequence[Row]) -> str:
        values = [factor * value for value in _values(rows, key)]
        return f"{np.median(values):.3f} ({worst(values):.2f})" if values else ""

    return cell


def _covered(rows: Sequence[Row]) -> str:
    shares = [_median(f"covers {share}", ".0%")(rows) for share in (68, 95)]
    return ", ".join(shares) if all(shares) else ""


SECONDS = [("s", _median("seconds", ".2g")), ("CPU s", _median("CPU seconds", ".2g"))]
OF_TRUTH: list[Column] = [
    ("refused", _refused),
    ("worse: low, fine, likeness", _worse),
    ("low", _spread("low", max)),
    ("limit", _median("limit", ".3f")),
    ("fine", _spread("fine", max)),
    ("likeness", _spread("likeness", min)),
    ("raw", _median("raw likeness", ".3f")),
    ("false bad, %", _spread("bad, false", max, 100)),
    ("found", _median("bad, found", ".0%")),
    ("1, 2 sigmas cover", _covered),
    *SECONDS,
]
OF_CORRECTED: list[Column] = [
    ("refused", _refused),
    ("low > 5 %", _taken),
    ("low", _spread("low", max)),
    ("fine", _spread("fine", max)),
    ("unevenness", _spread("unevenness", max)),
    ("kept: fine", _spread("held-out fine", max)),
    ("slow", _spread("held-out slow", max)),
    ("bad, %", _spread("bad", max, 100)),
    *SECONDS,
]
