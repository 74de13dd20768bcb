"""The table of `make bench-nuc`, and what is said below it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

import numpy as np
from nuc_regimes import FORMER

HEADER = (
    "PSNR in dB after one best gain and level. The oracle is told everything but the scene; *told* is what is told "
    "everything but the scene and gain and offset: motion, noise, levels, strengths, bad pixels, who walks where. "
    "From told to the oracle is what the motion leaves open, from deepir to told what deepir loses. The gap is to the "
    "oracle; the radiometric error is in % of the range, after one level and no gain. A burst that deepir refuses "
    "counts as its one frame. Median over seeds; {}.\n\n"
    "| regime | n | one frame | average | average + scikit-image TV | deepir | told | oracle | lost | gap | "
    "radiometric error | seconds, 1 thread |\n|---|---|---|---|---|---|---|---|---|---|---|---|"
)

OPEN = 2.0  # dB from told to the oracle, from which on no small gap can be asked


@dataclass(frozen=True)
class Case:
    """The figures of one burst."""

    one_frame: float
    average: float
    smooth_average: float
    deepir: float
    told: float
    oracle: float
    radiometric: float
    seconds: float
    messages: list[str] = field(default_factory=list)

    @property
    def lost(self) -> float:
        """To what is told everything but scene and pattern, dB."""
        return self.told - self.deepir

    @property
    def open(self) -> float:
        """From there to the oracle: what the motion leaves open, dB."""
        return self.oracle - self.told

    @property
    def gap(self) -> float:
        """To the oracle, dB."""
        return self.oracle - self.deepir

    @property
    def gain(self) -> float:
        """Over the registered average, dB."""
        return self.deepir - self.average


@dataclass(frozen=True)
class Row:
    """A regime with so many frames: its cases by half, and why physics forbids a small gap, if it does."""

    regime: str
    n: int
    forbidden: str
    cases: dict[str, list[Case]]

    def median(self, name: str, half: str) -> float:
        """Over the seeds of a half."""
        known = [value for case in self.cases[half] if not np.isnan(value := getattr(case, name))]
        return float(np.median(known)) if known else np.nan

    def line(self) -> str:
        """Of the table."""
        columns = (
            "one_frame",
            "average",
            "smooth_average",
            "deepir",
            "told",
            "oracle",
            "lost",
            "gap",
            "radiometric",
            "seconds",
        )
        cells = [" / ".join(f"{self.median(name, half):.1f}" for half in self.cases) for name in columns]
        cells[-2] = " / ".join(f"{self.median('radiometric', half):.2f}" for half in self.cases)
        cells = [cell.replace("nan", "-") for cell in cells]
        return f"| {self.regime} | {self.n}{' *' if self.forbidden else ''} | " + " | ".join(cells) + " |"


def summary(rows: list[Row], halves: str) -> Iterator[str]:
    """Means, worst rows, and the messages."""
    possible = [row for row in rows if not row.forbidden]
    if possible:
        yield "\nRows marked * are left out of the figures that follow.\n"
        yield "| | " + " | ".join(f"half {half}" for half in halves) + " |\n|---|" + "---|" * len(halves)
        yield line("mean gap, dB", halves, lambda half: f"**{mean(possible, 'gap', half)}**")
        yield from by_frames("mean gap", possible, halves, "gap")
        yield line("worst row's gap, dB", halves, lambda half: worst(possible, half, "gap"))
        yield line(
            f"mean gap of rows that the motion leaves open by {OPEN:g} dB at most",
            halves,
            lambda half: mean(closed(possible, half), "gap", half),
        )
        yield line("worst of these", halves, lambda half: worst(closed(possible, half), half, "gap"))
        yield line("of the mean gap, left open by the motion, dB", halves, lambda half: mean(possible, "open", half))
        yield line("of the mean gap, lost, dB", halves, lambda half: f"**{mean(possible, 'lost', half)}**")
        yield from by_frames("lost", possible, halves, "lost")
        yield line("worst row's loss, dB", halves, lambda half: worst(possible, half, "lost"))
        yield line("mean gain over the average, dB", halves, lambda half: mean(possible, "gain", half))
        yield line("mean radiometric error, %", halves, lambda half: mean(possible, "radiometric", half))
        former = [row for row in possible if row.regime in FORMER]
        if former:
            yield line("mean gap, the ten regimes of 0.1.0", halves, lambda half: mean(former, "gap", half))
    if any(row.forbidden for row in rows):
        yield "\nWhat physics forbids (*):\n"
        for regime, reason in dict.fromkeys((row.regime, row.forbidden) for row in rows if row.forbidden):
            numbers = [row.n for row in rows if (row.regime, row.forbidden) == (regime, reason)]
            yield f"- {regime}, n = {', '.join(map(str, numbers))}: {reason}."
    yield from messages(rows)


def by_frames(title: str, rows: list[Row], halves: str, name: str) -> Iterator[str]:
    """A line of means for each number of frames."""
    for n in sorted({row.n for row in rows}):
        those = [row for row in rows if row.n == n]
        yield line(f"{title}, n = {n}", halves, lambda half: mean(those, name, half))  # noqa: B023 - called at once


def closed(rows: list[Row], half: str) -> list[Row]:
    """Those where the pattern can be told from the scene, by who is told all else."""
    return [row for row in rows if row.median("open", half) <= OPEN]


def line(name: str, halves: str, value: Callable[[str], str]) -> str:
    return f"| {name} | " + " | ".join(value(half) for half in halves) + " |"


def mean(rows: list[Row], name: str, half: str) -> str:
    """Over bursts."""
    found = [getattr(case, name) for row in rows for case in row.cases[half]]
    known = [value for value in found if not np.isnan(value)]
    return f"{np.mean(known):.2f}" if known else "-"


def worst(rows: list[Row], half: str, name: str) -> str:
    """The row with the largest median."""
    if not rows:
        return "-"
    row = max(rows, key=lambda row: row.median(name, half))
    return f"{row.median(name, half):.1f} ({row.regime}, n = {row.n})"


def messages(rows: list[Row]) -> Iterator[str]:
    """What deepir said, by row: of how many bursts, in the words that it had for the first."""
    yield "\nWhat deepir said of these bursts (of the others nothing):\n"
    for row in rows:
        cases = [case for those in row.cases.values() for case in those]
        said: dict[str, list[str]] = {}  # by the words without their numbers
        for words in (words for case in cases for words in case.messages):
            said.setdefault(re.sub(r"-?\d[\d.]*", "#", words), []).append(words)
        for same in said.values():
            mark = " *" if row.forbidden else ""
            yield f"- {row.regime}, n = {row.n}{mark}, {len(same)} of {len(cases)} bursts: {same[0]}"
