"""The axes of a sweep, and its cells."""

from __future__ import annotations

import itertools
import re
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from glob import glob
from pathlib import Path

from deepir.config import Config, load, read
from deepir.config.components import nested
from deepir.errors import ConfigError, DataError, DeepIRError
from deepir.io.frames import digest
from deepir.paths import expanded
from deepir.runner import prepare
from deepir.storage.folder import RunFolder
from deepir.storage.stored import check_unchanged, input_digests, pin_config

REPEAT_AXES = ("seed", "data.simulate.seed")  # axes over which medians are taken
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
    known = {path: [f"data.truth={truth}"] for path, truth in truths.items() if Path(truth).is_file()}
    choices = {name: [f"data.path={path}", *known.get(path, ())] for name, path in zip(names, paths, strict=True)}
    return Axis(BURST_AXIS, choices)


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


@dataclass(frozen=True)
class Cell:
    """One run: its values by axis, its complete configuration, its folder."""

    values: Mapping[str, str]
    config: Config
    folder: RunFolder

    @property
    def name(self) -> str:
        """Its values, as in the name of its folder."""
        return self.folder.path.name

    def state(self) -> str:
        """`new`, `interrupted` or `finished`.

        Raises:
            ConfigError: The folder holds a run of another configuration.
        """
        state = self.folder.state()
        if state == "new":
            return state
        then, now = (
            {key: value for key, value in nested(each.model_dump()) if not isinstance(value, Mapping)}
            for each in (read(self.folder.active.config), self.config)
        )
        for key in sorted(then.keys() | now.keys()):
            if key != "threads" and then.get(key) != now.get(key):
                raise ConfigError(
                    f"{self.folder.path} holds a run with {key}={then.get(key)}, not {now.get(key)}; replace all with "
                    "--overwrite, or give another folder with output.dir=DIR"
                )
        return state


def make_cells(name: str, settings: Sequence[str], axes: Sequence[Axis], base: Path, threads: int) -> list[Cell]:
    """The product of the axes' choices.

    Args:
        name: The configuration.
        settings: `key=value`, for all cells.
        axes: The axes; the last varies fastest.
        base: The folder of the cells' folders.
        threads: Threads of each run whose configuration has none.

    Raises:
        ConfigError: A value is wrong.
    """
    found = []
    for labels in itertools.product(*(axis.choices for axis in axes)):
        chosen = [axis.choices[label] for axis, label in zip(axes, labels, strict=True)]
        config = load(name, [*settings, *itertools.chain(*chosen)])
        values = {axis.key: label for axis, label in zip(axes, labels, strict=True)}
        found.append((values, config))
    most = max((c.data.frames for _, c in found if isinstance(c.data.frames, int)), default=None)
    names = Counter(folder_name(values) for values, _ in found)
    if clash := next((each for each, count in names.items() if count > 1), None):
        raise ConfigError(f"{clash}: two cells would have this folder; give values that differ in letters or digits")
    return [_cell(values, _one_burst(config, most), base / folder_name(values), threads) for values, config in found]


def _cell(values: Mapping[str, str], config: Config, path: Path, threads: int) -> Cell:
    folder = RunFolder(expanded(path).absolute())
    return Cell(values, pin_config(config.model_copy(update={"threads": config.threads or threads}), folder), folder)


def _one_burst(config: Config, most: int | None) -> Config:
    """Configuration in which all numbers of frames are the first ones of one simulated burst."""
    simulate = config.data.simulate
    if simulate is None or most is None or simulate.get("n_frames") is not None:
        return config
    data = config.data.model_copy(update={"simulate": simulate | {"n_frames": most}})
    return config.model_copy(update={"data": data})


def check_cells(found: Sequence[Cell], finished: Sequence[Cell] = ()) -> None:
    """Check all cells before anything runs, except for the files of an axis of bursts.

    Configurations that differ only in seeds are checked once, on one burst that can be read; not if one is `finished`.

    Raises:
        DeepIRError: The message names the cell, unless the error is common to others.
    """
    checked = {_check_key(cell) for cell in finished}
    unread: dict[tuple[str, ...], DataError] = {}
    for cell in found:
        kind = _check_key(cell)
        if kind in checked:
            continue
        error = _error_of(cell)
        if error is None:
            checked.add(kind)
            unread.pop(kind, None)
            continue
        other = next((each for each in reversed(found) if _check_key(each) != kind), None)
        common = other is not None and str(_error_of(other)) == str(error)
        named = error if common else type(error)(f"{cell.name}: {error}")
        if not (isinstance(named, DataError) and BURST_AXIS in cell.values):
            raise named
        unread[kind] = named
    if unread:
        raise next(iter(unread.values()))


def _error_of(cell: Cell) -> DeepIRError | None:
    """The error of a cell; None if it can run."""
    try:
        prepare(cell.config)
    except DeepIRError as error:
        return error
    return None


def _check_key(cell: Cell) -> tuple[str, ...]:
    """Values of a cell that matter to a check."""
    return tuple(value for key, value in cell.values.items() if key not in ("seed", BURST_AXIS))


def check_inputs(found: Sequence[Cell]) -> None:
    """Compare the data of finished cells with those at their start.

    Raises:
        ConfigError: A file has changed.
    """
    for cell in found:
        if cell.state() == "finished":
            data = cell.config.sources().values()
            now = input_digests(cell.config, ["" if each.path is None else digest(each.path) for each in data])
            check_unchanged(cell.folder.record().inputs, now, cell.folder.path)
