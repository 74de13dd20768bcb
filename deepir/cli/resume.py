"""`deepir resume`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepir.cli.arguments import Plugins, load_plugins


def resume(
    folder: Annotated[Path, typer.Argument(metavar="RUN", help="The run's folder.", show_default=False)],
    plugin: Plugins = None,
) -> int:
    """Finish a run that was interrupted, from its last checkpoint."""
    plugins = load_plugins(plugin)
    from deepir.cli.run import report
    from deepir.cli.signals import Interrupted, Interruptible, farewell
    from deepir.report.progress import on_stderr
    from deepir.storage import stored

    try:
        with Interruptible() as interruptible, on_stderr() as progress:
            result = stored.resume(folder, plugins=plugins, callbacks=[interruptible, progress])
    except Interrupted as error:
        return farewell(error, folder)
    if result is None:
        typer.echo(f"{folder}: already finished")
    else:
        report(result, folder)
    return 0
