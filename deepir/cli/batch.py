"""`deepir batch`."""

from __future__ import annotations

from typing import Annotated

import typer

from deepir.cli.arguments import Overwrite, Plugins, load_plugins, parted
from deepir.cli.compare import Scheduler, Workers, finish, folder


def batch(
    config: Annotated[
        str, typer.Argument(help="A shipped configuration (nuc) or a .yaml file.", show_default=False)
    ],
    what: Annotated[
        list[str],
        typer.Argument(
            metavar="BURST... [KEY=VALUE]...",
            help="Files, folders of pictures or globs of these; settings for all of them.",
            show_default=False,
        ),
    ],
    workers: Workers = None,
    scheduler: Scheduler = None,
    overwrite: Overwrite = False,
    plugin: Plugins = None,
) -> int:
    """Correct many bursts the same way: deepir batch nuc 'bursts/*.tiff' [prior=tv ...].

    Results go to output.dir (runs/NAME-batch): a folder for each burst, table.md and table.csv.
    The same command again goes on where it was interrupted.
    """
    plugins = load_plugins(plugin)
    from deepir.errors import ConfigError, DataError
    from deepir.sweep.axes import bursts, listed
    from deepir.sweep.sweep import prepare

    patterns, settings = parted(what)
    if not patterns:
        raise DataError("no burst: give files, folders of pictures or a glob, for example 'bursts/*.tiff'")
    if any(each.partition("=")[0].strip() == "data.path" for each in settings):
        raise ConfigError("data.path: bursts are given without it, for example deepir batch nuc burst.npz")
    fixed, axes = listed(settings)
    checked = prepare(
        config,
        fixed,
        [bursts(patterns), *axes],
        folder=folder(config, "batch"),
        workers=workers,
        remote=scheduler is not None,
        overwrite=overwrite,
    )
    return finish(checked, ["batch", config, *what], scheduler, plugins)
