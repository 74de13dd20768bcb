"""`deepir compare` and `deepir batch`."""

from __future__ import annotations

import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import ConfigName, Overwrite, Plugins, config_stem, load_plugins, split_arguments
from deepir.cli.terminal import Interrupted, Interruptible, echo, notify

if TYPE_CHECKING:
    from deepir.sweep.cells import Axis, Cell
    from deepir.sweep.sweep import Sweep
    from deepir.sweep.table import Row

Workers = Annotated[int | None, typer.Option(min=1, help="Processes to start; by default one for each core.")]
Scheduler = Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT", help="Use a running Dask cluster.")]


def compare(
    config: ConfigName,
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE,VALUE", help="Settings; all combinations are run."),
    ] = None,
    paper: Annotated[bool, typer.Option("--paper", help="Also write paper.tex, paper.csv and paper.pdf.")] = False,
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Run all combinations of values: deepir compare nuc data.path=burst.npz method=joint,average data.frames=3,5,10.

    Results go to output.dir (runs/NAME-compare): a folder for each run, report.html, table.md, table.csv and
    quality.png. The same command again continues an interrupted comparison. With --paper a LaTeX table of means and
    standard deviations over seeds and bursts, all figures in long form, and pictures of scenes and errors.
    """
    plugins = load_plugins(plugin)
    command = ["compare", config, *(settings or ())]
    return _sweep(command, settings or (), [], workers, scheduler, overwrite=overwrite, plugins=plugins, paper=paper)


def batch(
    config: ConfigName,
    what: Annotated[
        list[str],
        typer.Argument(
            metavar="BURST|KEY=VALUE",
            help="Files, folders of pictures or globs of these; settings for all of them.",
        ),
    ],
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Correct many bursts the same way: deepir batch nuc 'bursts/*.tiff' [prior=tv ...].

    Results go to output.dir (runs/NAME-batch): a folder for each burst, table.md and table.csv.
    The same command again continues an interrupted batch.
    """
    plugins = load_plugins(plugin)
    from deepir.errors import ConfigError, DataError
    from deepir.sweep.cells import burst_axis

    patterns, settings = split_arguments(what)
    if not patterns:
        raise DataError("no burst: give files, folders of pictures or a glob, for example 'bursts/*.tiff'")
    if any(each.partition("=")[0].strip() == "data.path" for each in settings):
        raise ConfigError("data.path: bursts are given without it, for example deepir batch nuc burst.npz")
    bursts = [burst_axis(patterns)]
    command = ["batch", config, *what]
    return _sweep(command, settings, bursts, workers, scheduler, overwrite=overwrite, plugins=plugins)


def _sweep(
    command: Sequence[str],
    settings: Sequence[str],
    bursts: Sequence[Axis],
    workers: int | None,
    scheduler: str | None,
    *,
    overwrite: bool,
    plugins: Sequence[str],
    paper: bool = False,
) -> int:
    """Run the missing cells, then write and print the table; the exit status.

    Args:
        command: The command line, for the table's title: kind of the sweep, configuration ...
        settings: `key=value` and `key=value,value`.
        bursts: The axis of bursts, if there is one.
        workers: Number of processes; None: one for each core.
        scheduler: Address of a Dask scheduler; None: local workers.
        overwrite: Replace former runs.
        plugins: Modules to import on the workers.
        paper: Whether to write the files of a paper.
    """
    from deepir.sweep.cells import parse_axes
    from deepir.sweep.sweep import prepare

    kind, config, *_ = command
    fixed, axes = parse_axes(settings)
    with prepare(
        config,
        fixed,
        [*bursts, *axes],
        folder=Path("runs") / f"{config_stem(config)}-{kind}",
        workers=workers,
        remote=scheduler is not None,
        overwrite=overwrite,
    ) as checked:
        status = 0
        try:
            with Interruptible():
                checked.run(_Progress(checked), scheduler, plugins)
        except Interrupted as error:
            notify("interrupted; the same command continues with the missing runs")
            status = error.status
        _report(checked.write(shlex.join(["deepir", *command]), paper=paper), checked.folder, paper=paper)
        return status or int(bool(checked.errors))


class _Progress:
    """A line on stderr for each finished cell."""

    def __init__(self, checked: Sweep) -> None:
        todo, self.total = len(checked.unfinished()), len(checked.cells)
        self.done = self.total - todo
        if self.done:
            notify(f"{self.done} of {self.total} runs are finished already")

    def __call__(self, cell: Cell, error: str | None) -> None:
        from deepir.sweep.table import metrics_line

        self.done += 1
        end = f"failed: {error}" if error else metrics_line(cell)
        notify(f"{self.done}/{self.total} {cell.name}: {end}")


def _report(rows: Sequence[Row], where: Path, *, paper: bool) -> None:
    """Print the table and the paths of the files."""
    from rich import box
    from rich.console import Console
    from rich.markup import escape
    from rich.table import Table

    from deepir.paths import printable
    from deepir.sweep.table import table_lines

    heads, body = table_lines(rows)
    shown = Table(*map(escape, heads), box=box.SIMPLE)
    for line in body:
        shown.add_row(*(escape(printable(each)) for each in line))
    Console(width=None if sys.stdout.isatty() else 200).print(shown)
    plots = "; plots: quality.png" * (where / "quality.png").exists()
    plots += "; for a paper: paper.tex, paper.csv" * paper + ", paper.pdf" * (where / "paper.pdf").exists()
    echo(f"results: {where}/table.md, table.csv and a folder for each run{plots}; to look at: report.html")
