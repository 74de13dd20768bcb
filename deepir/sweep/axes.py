"""Axes of a sweep: `prior=tv,dip`, or one burst after another."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path

from deepir.errors import ConfigError, DataError
from deepir.paths import expanded

#: Axes over which medians are taken.
REPEAT_AXES = ("seed", "data.simulate.seed")
BURST_AXIS = "burst"  # key of the axis of bursts
#: Files of a sweep, beside the folders of its cells.
SWEEP_FILES = ("table.md", "table.csv", "quality.png", "report.html")
BRACKETS = {"[": 1, "{": 1, "(": 1, "]": -1, "}": -1, ")": -1}  # change of the depth of nesting


@dataclass(frozen=True)
class Axis:
    """A key, and for each label of its values the settings."""

    key: str
    choices: Mapping[str, Sequence[str]]


def parse_axes(settings: Sequence[str]) -> tuple[list[str], list[Axis]]:
    """Split settings into those with one value and axes: `prior=tv,dip`.

    A comma within brackets or quotes belongs to a value. Of a key given twice, the last counts.

    Raises:
        ConfigError: All values of an axis are equal.
    """
    fixed: list[str] = []
    axes: dict[str, Axis] = {}
    for setting in settings:
        key, _, text = (part.strip() for part in setting.partition("="))
        values = [value.strip() for value in split_at_commas(text)]
        axes.pop(key, None)  # as everywhere: of a key given twice, the last counts
        if len(values) == 1:
            fixed.append(setting)
        else:
            if len(set(values)) == 1:
                raise ConfigError(f"{setting}: nothing varies, {values[0]} is listed {len(values)} times")
            axes[key] = Axis(key, {value: [f"{key}={value}"] for value in values})
    return fixed, list(axes.values())


def split_at_commas(text: str) -> list[str]:
    """Split a text at its commas outside brackets and quotes.

    >>> split_at_commas("[0, 3],5")
    ['[0, 3]', '5']
    """
    parts, depth, quote = [""], 0, ""
    for letter in text:
        if quote:
            quote = "" if letter == quote else quote
        elif letter in ("'", '"'):
            quote = letter
        depth += (not quote) * BRACKETS.get(letter, 0)
        if letter == "," and depth <= 0 and not quote:
            parts.append("")
        else:
            parts[-1] += letter
    return parts


def burst_axis(patterns: Sequence[str]) -> Axis:
    """An axis of bursts: files, folders of pictures, and globs of these.

    STEM_truth.npz is the truth of STEM.npz beside it, as `deepir simulate` writes them.

    Raises:
        DataError: A pattern matches nothing.
    """
    found: dict[str, None] = {}
    for pattern in patterns:
        at = str(expanded(pattern))
        matches = [at] if Path(at).exists() else sorted(glob(at, recursive=True))  # noqa: PTH207 - keeps absolute ones
        if not matches:
            raise DataError(f"{pattern}: no such file, and no burst matches it")
        found |= dict.fromkeys(matches)
    truths = {path: f"{path.removesuffix('.npz')}_truth.npz" for path in found if path.endswith(".npz")}
    paths = [path for path in found if path not in truths.values()]
    stems = [Path(path).stem for path in paths]
    names = stems if len(set(stems)) == len(stems) else paths
    return Axis(
        BURST_AXIS,
        {name: _burst(path, truths.get(path, "")) for name, path in zip(names, paths, strict=True)},
    )


def _burst(path: str, truth: str) -> list[str]:
    known = [f"data.truth={truth}"] if truth and Path(truth).is_file() else []
    return [f"data.path={path}", *known]


def folder_name(values: Mapping[str, str]) -> str:
    """Name of the folder of a cell: `prior=tv,seed=0`.

    It neither begins with a dot, as `..` does, nor is it that of a file of the sweep.

    Raises:
        ConfigError: It is too long.
    """
    parts = [value if key == BURST_AXIS else f"{key}={value}" for key, value in values.items()]
    name = ",".join(re.sub(r"[^\w.+=-]+", "-", part) for part in parts)
    if name.startswith(".") or name.lower() in SWEEP_FILES:
        name = f"{BURST_AXIS}={name}"
    if len(name.encode()) > 240:
        raise ConfigError(f"{name[:80]}...: too long for a folder; put long values into a .yaml file")
    return name
