"""`deepir run` and `deepir resume`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, Plugins, Settings, config_stem, load_plugins
from deepir.cli.terminal import echo

if TYPE_CHECKING:
    from deepir.config import Config
    from deepir.result import Result


def run(
    config: Annotated[
        str,
        typer.Argument(
            metavar="CONFIG", help="A shipped configuration (nuc) or a .yaml file.", show_default=False
        ),
    ],
    settings: Settings = None,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Correct a burst: deepir run nuc data.path=burst.npz [prior=tv ...].

    Results go to output.dir (runs/NAME). `deepir list` shows what the settings may name.
    """
    plugins = load_plugins(plugin)
    from deepir.config import load

    checked = load(config, settings or ())
    return run_and_store(checked, output_folder(checked, config), overwrite=overwrite, plugins=plugins)


def resume(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder.", show_default=False)],
    plugin: Plugins = None,
) -> int:
    """Finish a run that was interrupted, from its last checkpoint."""
    plugins = load_plugins(plugin)
    from deepir.cli.terminal import Interrupted, Interruptible, report_interrupted
    from deepir.report.progress import show_progress
    from deepir.storage import stored

    try:
        with Interruptible() as interruptible, show_progress() as progress:
            result = stored.resume(folder, plugins=plugins, callbacks=[interruptible, progress])
    except Interrupted as error:
        return report_interrupted(error, folder)
    if result is None:
        echo(f"{folder}: already finished")
    else:
        report_result(result, folder)
    return 0


def output_folder(config: Config, name: str) -> Path:
    """`output.dir`, or runs/NAME of the configuration's name."""
    from deepir.paths import expanded

    if config.output.dir is not None:
        return expanded(config.output.dir)
    return Path("runs") / config_stem(name)


def run_and_store(config: Config, folder: Path, *, overwrite: bool, plugins: list[str]) -> int:
    """Run into a folder, with progress on stderr.

    Returns:
        The exit status.
    """
    from deepir.cli.terminal import Interrupted, Interruptible, report_interrupted
    from deepir.report.progress import show_progress
    from deepir.storage.stored import run_into

    try:
        with Interruptible() as interruptible, show_progress() as progress:
            both = (interruptible, progress)
            result = run_into(config, folder, overwrite=overwrite, plugins=plugins, callbacks=both)
    except Interrupted as error:
        return report_interrupted(error, folder)
    report_result(result, folder)
    return 0


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
    echo(
        f"results: {folder}/result.npz, {folder}/scene.tiff; to look at: {folder}/report.html, {folder}/summary.png"
    )
