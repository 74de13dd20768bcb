"""Tables of the benchmark of record: medians, interquartile ranges, gaps to the oracle, margins over the rivals."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from record_protocol import DEFAULT, TOLD, Protocol

from deepir.sweep.cells import BURST_AXIS
from deepir.sweep.table import Row

FRAMES = "data.frames"
QUALITY = "psnr_aligned"
#: Heading, metric, by how much it is multiplied (None: 100 / range of the burst's scene), and decimals.
COLUMNS: tuple[tuple[str, str, float | None, int], ...] = (
    ("SSIM", "ssim_aligned", 1.0, 3),
    ("gap, dB", "gap", 1.0, 1),
    ("radiometric, mK", "radiometric_rmse_mk", 1.0, 0),
    ("radiometric, %", "radiometric_rmse", None, 2),
    ("columns, %", "residual_columns", None, 2),
    ("pixels, %", "residual_pixels", None, 2),
    ("roughness", "roughness", 1.0, 4),
    ("motion, px", "motion_rmse", 1.0, 3),
    ("gain, %", "gain_rmse", 100.0, 2),
    ("offset, %", "offset_rmse", None, 2),
    ("stray, %", "stray_rmse", None, 1),
    ("held out, counts", "held_out_frame", 1.0, 1),
    ("pattern", "pattern_correlation", 1.0, 3),
    ("seconds", "seconds", 1.0, 1),
    ("MB", "peak_memory_mb", 1.0, 0),
)


@dataclass(frozen=True)
class Found:
    """A protocol, and what its cells found: `gap` to the oracle is among the metrics of each that has one."""

    protocol: Protocol
    rows: Sequence[Row]

    def numbers(self) -> list[str]:
        """Of frames, as they were asked for, in order."""
        return list(dict.fromkeys(row.values[FRAMES] for row in self.rows))

    def methods(self, n: str | None = None) -> list[str]:
        """That were asked for, with so many frames."""
        return list(dict.fromkeys(row.values["method"] for row in self.rows if n in (None, row.values[FRAMES])))

    def values(self, method: str, n: str, metric: str) -> list[float]:
        """A metric of the bursts that are finished."""
        rows = [row for row in self.rows if (row.values["method"], row.values[FRAMES]) == (method, n)]
        found = [row.metrics.get(metric) for row in rows]
        return [float(each) for each in found if each is not None]

    def median(self, method: str, n: str, metric: str) -> float:
        """NaN where there is none."""
        found = self.values(method, n, metric)
        return float(np.median(found)) if found else float("nan")

    def range(self) -> float:
        """Of the scenes, in the data's units."""
        return next((each.range for each in self.protocol.bursts.values()), 1.0)

    def best(self, n: str, *, rivals: bool) -> str | None:
        """The method of the best median: of the rivals that are told no more than the burst, or of deepir's priors."""
        ours = [each for each in self.methods(n) if each.startswith(DEFAULT)]
        among = [each for each in self.methods(n) if each not in (*ours, *TOLD, "one_frame")] if rivals else ours
        known = {each: value for each in among if np.isfinite(value := self.median(each, n, QUALITY))}
        return max(known, key=known.__getitem__) if known else None


def with_gaps(rows: Sequence[Row]) -> list[Row]:
    """The rows, with the gap to the oracle of the same burst and number of frames where there is one."""
    best = {_case(row): row.metrics.get(QUALITY) for row in rows if row.values["method"] == "oracle"}
    for row in rows:
        top, own = best.get(_case(row)), row.metrics.get(QUALITY)
        if top is not None and own is not None and isinstance(row.metrics, dict):
            row.metrics["gap"] = top - own
    return list(rows)


def _case(row: Row) -> tuple[str, str]:
    return row.values[BURST_AXIS], row.values[FRAMES]


def table(found: Found, n: str) -> Iterator[str]:
    """Lines of markdown: the methods with so many frames, the best first."""
    methods = [each for each in found.methods(n) if found.values(each, n, "seconds")]
    shown = [each for each in COLUMNS if any(found.values(method, n, each[1]) for method in methods)]
    if any(each[1] == "radiometric_rmse_mk" for each in shown):
        shown = [each for each in shown if each[1] != "radiometric_rmse"]
    graded = any(found.values(method, n, QUALITY) for method in methods)
    heads = ["method", "bursts", *(["PSNR, dB (quartiles)"] if graded else []), *(each[0] for each in shown)]
    yield f"| {' | '.join(heads)} |"
    yield "|---" * len(heads) + "|"
    order = _order(found, n, QUALITY if graded else "roughness", down=graded)
    for method in sorted(methods, key=order):
        cells = [f"**{method}**" if method == DEFAULT else method, str(len(found.values(method, n, "seconds")))]
        cells += [spread(found.values(method, n, QUALITY))] if graded else []
        for _, metric, factor, decimals in shown:
            value = found.median(method, n, metric) * (100 / found.range() if factor is None else factor)
            cells.append(f"{value:.{decimals}f}" if np.isfinite(value) else "")
        yield f"| {' | '.join(cells)} |"


def _order(found: Found, n: str, metric: str, *, down: bool) -> Callable[[str], float]:
    def key(method: str) -> float:
        value = found.median(method, n, metric)
        return float("inf") if np.isnan(value) else -value if down else value

    return key


def spread(values: Sequence[float]) -> str:
    """The median, and the quartiles."""
    if not values:
        return ""
    low, middle, high = np.percentile(values, [25, 50, 75])
    return f"{middle:.1f} ({low:.1f} to {high:.1f})" if len(values) > 1 else f"{middle:.1f}"


def margins(everything: Mapping[str, Found]) -> Iterator[str]:
    """Lines of markdown: the default's median less that of the best rival that is told no more than the burst."""
    heads = [
        "protocol",
        "frames",
        "deepir, dB",
        "best rival",
        "its dB",
        "margin, dB",
        "best prior",
        "its dB",
        "gap, dB",
    ]
    yield f"| {' | '.join(heads)} |"
    yield "|---" * len(heads) + "|"
    for key, found in everything.items():
        for n in found.numbers():
            own, rival = found.median(DEFAULT, n, QUALITY), found.best(n, rivals=True)
            if rival is None or not np.isfinite(own):
                continue
            other, gap = found.median(rival, n, QUALITY), found.median(DEFAULT, n, "gap")
            prior = found.best(n, rivals=False)
            ours = f"{prior} | {found.median(prior, n, QUALITY):.1f}" if prior else " | "
            gaps = f"{gap:.1f}" if np.isfinite(gap) else ""
            yield (f"| ({key}) | {n} | {own:.1f} | {rival} | {other:.1f} | **{own - other:+.1f}** | {ours} | {gaps} |")
