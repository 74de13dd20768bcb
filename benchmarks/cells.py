"""Cells of a table: worked on side by side, and kept in runs/bench-nuc, so that a run that was cut short goes on."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context

import torch
from nuc_store import Arrays, finished, kept

Cell = tuple[str | int, ...]
EVERYTHING = ("**/*.py", "../configs/**/*.yaml")  # a change of any of these makes other figures


def worked(
    kind: str,
    cells: Iterable[Cell],
    measure: Callable[..., Arrays],
    *,
    code: str,
    workers: int = 1,
    fresh: bool = False,
) -> dict[Cell, Arrays]:
    """What `measure(*cell)` finds for each cell, by `workers` processes of one thread each.

    A cell is kept under its own words and `code`, which stands for all else that its figures depend on.
    """
    wanted = list(dict.fromkeys(cells))
    work = partial(_kept, kind, measure, code, fresh)
    if workers == 1:
        torch.set_num_threads(1)
        return _told(wanted, map(work, wanted))
    with ProcessPoolExecutor(workers, get_context("spawn"), torch.set_num_threads, (1,)) as pool:
        return _told(wanted, pool.map(work, wanted))


def done(kind: str, cells: Iterable[Cell], *, code: str) -> dict[Cell, Arrays]:
    """Those of the cells that `worked` is through with."""
    found = {cell: finished(kind, [*cell, code]) for cell in cells}
    return {cell: arrays for cell, arrays in found.items() if arrays is not None}


def _told(cells: list[Cell], results: Iterable[Arrays]) -> dict[Cell, Arrays]:
    """The results by cell; as each comes, a line says how far it is."""
    found, began = {}, time.monotonic()
    for cell, arrays in zip(cells, results, strict=True):
        found[cell] = arrays
        passed = f"{len(found)}/{len(cells)}, {time.monotonic() - began:.0f} s"
        print(f"{passed}: {' '.join(map(str, cell))}", file=sys.stderr, flush=True)
    return found


def _kept(kind: str, measure: Callable[..., Arrays], code: str, fresh: bool, cell: Cell) -> Arrays:
    return kept(kind, [*cell, code], lambda: measure(*cell), fresh=fresh)
