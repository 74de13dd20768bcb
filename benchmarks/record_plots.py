"""Pictures of the benchmark of record, drawn from its cells: quality against frames, against seconds, and gaps."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from record_protocol import ALL, DEFAULT, NETWORKS, PRIORS, TOLD
from record_tables import QUALITY, Found

MOST = 9  # curves in a picture: the best
COLOURS = ("tab:blue", "tab:green", "tab:orange", "tab:purple", "tab:brown", "tab:cyan", "0.4", "tab:olive", "k")
MARKERS = "osD^vP*"


def against_frames(path: Path, everything: Mapping[str, Found]) -> bool:
    """Medians of the best methods by the number of frames, with quartiles; whether there is anything to draw."""
    chosen = {key: each for key, each in everything.items() if len(_finished(each)) > 1}
    if not chosen:
        return False
    figure, places = _figure(len(chosen))
    for axes, (key, found) in zip(places, chosen.items(), strict=True):
        numbers = _finished(found)
        for method in _best(found, numbers, MOST):
            at = [n for n in numbers if found.values(method, n, QUALITY)]
            spreads = np.array([np.percentile(found.values(method, n, QUALITY), [25, 50, 75]) for n in at]).T
            bars = [spreads[1] - spreads[0], spreads[2] - spreads[1]]
            axes.errorbar([int(n) for n in at], spreads[1], yerr=bars, label=method, **_style(method))
        axes.set(title=f"({key})", xlabel="frames", ylabel="PSNR, dB", xscale="log")
        axes.set_xticks([int(n) for n in numbers], numbers)
        axes.minorticks_off()
    return _save(figure, places, path)


def against_seconds(path: Path, everything: Mapping[str, Found], n: str = "5") -> bool:
    """Medians of all methods with `n` frames by their seconds."""
    from matplotlib.ticker import LogLocator, NullFormatter

    chosen = {key: each for key, each in everything.items() if n in _finished(each)}
    if not chosen:
        return False
    figure, places = _figure(len(chosen))
    for axes, (key, found) in zip(places, chosen.items(), strict=True):
        for method in _best(found, [n]):
            x, y = (found.median(method, n, metric) for metric in ("seconds", QUALITY))
            if method != "one_frame":
                axes.errorbar(max(x, 0.05), y, label=method, **_style(method))
        axes.set(title=f"({key}), {n} frames", xlabel="seconds, one thread", ylabel="PSNR, dB", xscale="log")
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_minor_formatter(NullFormatter())
        axes.xaxis.set_major_formatter("{x:g}")
    return _save(figure, places, path)


def gaps(path: Path, everything: Mapping[str, Found], n: str = "5") -> bool:
    """Gaps to the oracle of all methods with `n` frames, the smallest first."""
    chosen = {key: each for key, each in everything.items() if each.values("oracle", n, QUALITY)}
    if not chosen:
        return False
    figure, places = _figure(len(chosen))
    for axes, (key, found) in zip(places, chosen.items(), strict=True):
        known = {m: found.values(m, n, "gap") for m in found.methods(n) if m != "oracle"}
        order = sorted((m for m in known if known[m]), key=lambda m: -float(np.median(known[m])))
        quartiles = np.array([np.percentile(known[m], [25, 50, 75]) for m in order]).T
        bars = [quartiles[1] - quartiles[0], quartiles[2] - quartiles[1]]
        axes.barh(order, quartiles[1], xerr=bars, color=["tab:red" if m == DEFAULT else "0.7" for m in order])
        axes.set(title=f"({key}), {n} frames", xlabel="gap to the oracle, dB")
        axes.tick_params(axis="y", labelsize=7)
    return _save(figure, places, path, legend=False)


def _finished(found: Found) -> list[str]:
    numbers = [n for n in found.numbers() if n.isdecimal() and found.values(DEFAULT, n, QUALITY)]
    return sorted(numbers, key=int)


def _best(found: Found, numbers: Sequence[str], most: int | None = None) -> list[str]:
    """The methods to draw: the best, all or `most` of them, with the number of frames in the middle."""
    middle = numbers[len(numbers) // 2]
    known = [m for m in found.methods(middle) if found.values(m, middle, QUALITY)]
    return sorted(known, key=lambda m: -found.median(m, middle, QUALITY))[:most]


def _style(method: str) -> dict[str, Any]:
    """The default stands out; what is told more than the burst is dashed; the same method looks the same everywhere."""
    if method == DEFAULT:
        return {"color": "tab:red", "marker": "o", "markersize": 6, "linewidth": 2, "capsize": 2, "zorder": 9}
    known = [*ALL, *PRIORS, *NETWORKS]
    place = known.index(method) if method in known else len(known)
    style = {"color": COLOURS[place % len(COLOURS)], "marker": MARKERS[place % len(MARKERS)]}
    return style | {"markersize": 4, "linewidth": 1, "capsize": 2, "linestyle": "--" if method in TOLD else "-"}


def _figure(count: int) -> tuple[Any, list[Any]]:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    rows, columns = -(-count // 2), min(count, 2)
    figure = Figure(figsize=(5.5 * columns, 4.2 * rows), layout="constrained", facecolor="white")
    FigureCanvasAgg(figure)
    places = list(figure.subplots(rows, columns, squeeze=False).ravel())
    for axes in places[count:]:
        axes.set_axis_off()
    return figure, places[:count]


def _save(figure: Any, places: Sequence[Any], path: Path, *, legend: bool = True) -> bool:
    for axes in places:
        axes.grid(alpha=0.3)
        if legend:
            axes.legend(fontsize=6)
    figure.savefig(path, dpi=100, metadata={"Software": None})
    return True
