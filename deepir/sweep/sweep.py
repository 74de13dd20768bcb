"""A sweep from its settings to its table."""

from __future__ import annotations

import importlib.util
import math
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from deepir.config import dump, load
from deepir.errors import ConfigError
from deepir.io.output import write_text
from deepir.paths import expanded
from deepir.storage.folder import Record, locked_folder, remove_temporaries
from deepir.sweep import table
from deepir.sweep.cells import SWEEP_FILES, Axis, Cell, check_cells, check_inputs, make_cells
from deepir.sweep.paper import write_paper


@dataclass
class Sweep:
    """Checked cells in a folder, with the errors so far."""

    folder: Path
    cells: list[Cell]
    workers: int
    errors: dict[str, str] = field(default_factory=dict)

    def unfinished(self) -> list[Cell]:
        """Cells that are not finished."""
        return [cell for cell in self.cells if cell.state() != "finished"]

    def run(self, report: Callable[[Cell, str | None], None], scheduler: str | None, plugins: Sequence[str]) -> None:
        """Finish all cells; `report` is called with each as it ends."""
        from deepir.sweep import cluster

        if cells := self.unfinished():
            workers = min(self.workers, len(cells))
            for cell, error in cluster.run_cells(cells, workers=workers, scheduler=scheduler, plugins=plugins):
                if error is not None:
                    self.errors[cell.name] = error
                report(cell, error)

    def write(self, title: str, *, paper: bool = False) -> list[table.Row]:
        """Write `table.csv`, `table.md`, `quality.png` and `report.html`, and those of a paper; the rows."""
        found = table.make_rows(self.cells, self.errors)
        write_text(self.folder / "table.md", table.markdown(found, title))
        write_text(self.folder / "table.csv", table.csv_table(found))
        table.write_plots(self.folder / "quality.png", found)
        table.write_report(self.folder / "report.html", found, title)
        if paper:
            write_paper(self.folder, self.cells, found)
        return found


@contextmanager
def prepare(
    name: str,
    settings: Sequence[str],
    axes: Sequence[Axis],
    *,
    folder: Path,
    workers: int | None = None,
    remote: bool = False,
    overwrite: bool = False,
) -> Iterator[Sweep]:
    """A context in which everything is checked, the runs are listed, and no other process writes into the folder.

    There are as many workers as cores, or as cells if these are fewer; each run has its share of the cores as threads,
    or the `threads` of its configuration. On workers elsewhere (`remote`) it has one.

    Args:
        name: The configuration.
        settings: `key=value`, for all cells.
        axes: The axes.
        folder: Folder of the cells' folders, unless `output.dir` is set.
        workers: Number of processes; None: as above.
        remote: True: the workers are those of another cluster.
        overwrite: Replace former runs of these cells, each when the new one is finished.

    Raises:
        DeepIRError: A setting, a file or the folder is wrong; nothing is written.
    """
    if importlib.util.find_spec("distributed") is None:
        raise ConfigError("compare and batch run on Dask, which is missing: pip install 'deepir[compare]'")
    from deepir.sweep import cluster

    if any(axis.key.partition(".")[0] == "output" for axis in axes):
        raise ConfigError("output.dir: the results of all cells go into one folder, each into its own within it")
    if not axes:
        raise ConfigError("nothing varies: list values with commas, for example prior=tv,dip seed=0,1,2")
    first = load(name, [*settings, *(each for axis in axes for each in next(iter(axis.choices.values())))])
    base = expanded(first.output.dir or folder).absolute()
    at_once = max(1, cluster.CORES // (first.threads or 1))
    count = workers or min(math.prod(len(axis.choices) for axis in axes), at_once)
    found = make_cells(name, settings, axes, base, 1 if remote else max(1, cluster.CORES // count))
    with locked_folder(base):
        remove_temporaries(base, SWEEP_FILES)
        table.check_free(base)
        if overwrite:
            _begin_again(found)
        else:
            finished = [cell for cell in found if cell.state() == "finished"]
            check_cells([cell for cell in found if cell not in finished], finished)
            check_inputs(found)
        yield Sweep(base, found, count)


def _begin_again(cells: Sequence[Cell]) -> None:
    """Check all cells, and mark those of former runs as unfinished."""
    for cell in cells:
        cell.folder.check_free(overwrite=True)
    check_cells(cells)
    for cell in cells:
        if cell.folder.state() != "new":
            with cell.folder.lock():
                cell.folder.begin(dump(cell.config), Record())
