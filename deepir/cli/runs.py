"""Commands that solve: `run`, `resume`, `demo`, `compare`, `batch` and `train`."""

from __future__ import annotations

import itertools
import shlex
import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import (
    ConfigName,
    Overwrite,
    Plugins,
    Settings,
    config_stem,
    held_outputs,
    load_plugins,
    split_arguments,
)
from deepir.cli.terminal import Interrupted, Interruptible, echo, notify, watched_solve

if TYPE_CHECKING:
    from deepir.config import Config
    from deepir.result import Result
    from deepir.sweep.cells import Axis, Cell
    from deepir.sweep.sweep import Sweep
    from deepir.sweep.table import Row
    from deepir.training.training import TrainingProgress

DEMO_FOLDER = Path("runs/demo")  # where the demo writes
DEMO_SHAPE = (256, 320)  # height and width of its frames, px
REPORT_INTERVAL = 250  # iterations between two lines of progress
Workers = Annotated[int | None, typer.Option(min=1, help="Processes to start; by default one for each core.")]
Scheduler = Annotated[str | None, typer.Option(metavar="tcp://HOST:PORT", help="Use a running Dask cluster.")]


def run(config: ConfigName, settings: Settings = None, overwrite: Overwrite = False, plugin: Plugins = None) -> None:
    """Correct a burst: deepir run nuc data.path=burst.npz [prior=tv ...].

    Results go to output.dir (runs/NAME). `deepir list` shows what the settings may name.
    """
    plugins = load_plugins(plugin)
    from deepir.config import load

    checked = load(config, settings or ())
    run_and_store(checked, output_folder(checked, config), overwrite=overwrite, plugins=plugins)


def resume(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder.")], plugin: Plugins = None
) -> None:
    """Finish a run that was interrupted, from its last checkpoint."""
    plugins = load_plugins(plugin)
    from deepir.storage import stored

    with watched_solve(folder) as callbacks:
        result = stored.resume(folder, plugins=plugins, callbacks=callbacks)
    if result is None:
        echo(f"{folder}: already finished")
    else:
        report_result(result, folder)


def output_folder(config: Config, name: str) -> Path:
    """`output.dir`, or runs/NAME of the configuration's name."""
    from deepir.paths import expanded

    if config.output.dir is not None:
        return expanded(config.output.dir)
    return Path("runs") / config_stem(name)


def run_and_store(config: Config, folder: Path, *, overwrite: bool, plugins: list[str]) -> None:
    """Run into a folder, with progress on stderr, and print what came out."""
    from deepir.storage.stored import run_into

    with watched_solve(folder) as callbacks:
        result = run_into(config, folder, overwrite=overwrite, plugins=plugins, callbacks=callbacks)
    report_result(result, folder)


def report_result(result: Result, folder: Path) -> None:
    """Print figures of a result and the paths of its files."""
    import numpy as np

    from deepir.io.radiometry import ZERO_CELSIUS

    metrics = result.metrics
    count = metrics["iterations"]
    after = f" after {count} iteration{'s' if count > 1 else ''}" if count else ""  # some methods have none
    echo(f"{metrics['stop_reason']}{after}, {metrics['seconds']:.1f} s")
    if "psnr_aligned" in metrics:
        echo(f"PSNR {metrics['psnr']:.2f} dB, {metrics['psnr_aligned']:.2f} dB with gain and level aligned")
    kelvin = result.extra.get("scene_kelvin", np.empty(0))
    if (known := kelvin[np.isfinite(kelvin)]).size:
        low, high = known.min() - ZERO_CELSIUS, known.max() - ZERO_CELSIUS
        echo(f"temperatures {low:.2f} to {high:.2f} °C: {folder}/scene_kelvin.tiff")
    echo(f"results: {folder}/result.npz, {folder}/scene.tiff; to look at: {folder}/report.html, {folder}/summary.png")


def demo() -> None:
    """Correct a simulated burst of five frames in counts; results and pictures in runs/demo/."""
    from deepir.config import load
    from deepir.simulate import Settings, simulate
    from deepir.storage.folder import RunFolder

    folder = RunFolder(DEMO_FOLDER)
    with folder.lock():
        folder.check_free(overwrite=True)
        burst = simulate(None, Settings(n_frames=5, shape=DEMO_SHAPE, counts=True, max_rotation=1.0), seed=0)
        path, truth = burst.save(DEMO_FOLDER / "burst.npz")
    echo(f"simulated {path}; correcting it with: deepir run nuc data.path={path}")
    config = load("nuc", [f"data.path={path}", f"data.truth={truth}"])
    run_and_store(config, DEMO_FOLDER, overwrite=True, plugins=[])
    _compare()


def _compare() -> None:
    """PSNR of one frame, of the registered average, and of the result."""
    import json

    from deepir.config import read
    from deepir.metrics import scores
    from deepir.runner import execute, prepare

    config = read(DEMO_FOLDER / "config.yaml").model_copy(update={"method": "average"})
    data = prepare(config)
    rows = {
        "one frame": scores(data.frames[0], data.truth["scene"]),
        "registered average": execute(config, data).metrics,
        "deepir": json.loads((DEMO_FOLDER / "metrics.json").read_text(encoding="utf-8")),
    }
    echo("PSNR after the best gain and level:")
    for name, found in rows.items():
        echo(f"  {name:<20} {found['psnr_aligned']:6.2f} dB")


def compare(
    config: ConfigName,
    settings: Annotated[
        list[str] | None, typer.Argument(metavar="KEY=VALUE,VALUE", help="Settings; all combinations are run.")
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
    plugins, given = load_plugins(plugin), settings or []
    command = ["compare", config, *given]
    return _sweep(command, given, [], workers, scheduler, overwrite=overwrite, plugins=plugins, paper=paper)


def batch(
    config: ConfigName,
    what: Annotated[
        list[str],
        typer.Argument(
            metavar="BURST|KEY=VALUE", help="Files, folders of pictures or globs of these; settings for all of them."
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
    command, bursts = ["batch", config, *what], [burst_axis(patterns)]
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
                checked.run(_cell_lines(checked), scheduler, plugins)
        except Interrupted as error:
            notify("interrupted; the same command continues with the missing runs")
            status = error.status
        _report(checked.write(shlex.join(["deepir", *command]), paper=paper), checked.folder, paper=paper)
        return status or int(bool(checked.errors))


def _cell_lines(checked: Sweep) -> Callable[[Cell, str | None], None]:
    """A function that prints a line on stderr for each finished cell."""
    from deepir.sweep.table import metrics_line

    total = len(checked.cells)
    if done := total - len(checked.unfinished()):
        notify(f"{done} of {total} runs are finished already")
    numbers = itertools.count(done + 1)

    def finished(cell: Cell, error: str | None) -> None:
        notify(f"{next(numbers)}/{total} {cell.name}: {f'failed: {error}' if error else metrics_line(cell)}")

    return finished


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


def train(
    name: Annotated[str, typer.Argument(metavar="NAME", help="What to train: see `deepir list`.")],
    out: Annotated[
        Path | None, typer.Option(metavar="FILE.safetensors", help="File of the weights; default: NAME.safetensors.")
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of initial weights and training samples.")] = 0,
    iterations: Annotated[
        int | None, typer.Option(min=0, help="Number of iterations; default: that of the training.")
    ] = None,
    threads: Annotated[int, typer.Option(min=1, help="Number of threads; the weights depend on it.")] = 1,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> None:
    """Train a network on the CPU: deepir train denoiser."""
    load_plugins(plugin)
    import torch

    import deepir
    from deepir import weights
    from deepir.registry import lookup
    from deepir.training import training

    kind = lookup("training", name, "train")
    path = out or Path(f"{name}.safetensors")
    torch.set_num_threads(threads)
    about = {"training": name, "seed": seed, "iterations": iterations or kind.iterations, "threads": threads}
    about |= {"deepir": deepir.__version__, "torch": torch.__version__}
    with Interruptible(), held_outputs(path, overwrite=overwrite, suffix=".safetensors"):
        network = training.train(kind, seed=seed, iterations=iterations, report=_report_progress)
        weights.save(network, path, about)
    echo(f"weights: {path}")


def _report_progress(now: TrainingProgress) -> None:
    if now.iteration % REPORT_INTERVAL == 0 or now.iteration == now.iterations:
        left = now.seconds / now.iteration * (now.iterations - now.iteration)
        echo(f"{now.iteration}/{now.iterations}: loss {now.loss:.4f}, about {left:.0f} s to go", err=True)
