"""Arguments that several commands share."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

import typer

Settings = Annotated[
    list[str] | None,
    typer.Argument(
        metavar="[KEY=VALUE]...", help="Settings, for example data.path=burst.npz", show_default=False
    ),
]
Plugins = Annotated[
    list[str] | None,
    typer.Option(
        "--plugin", metavar="MODULE", help="Python module that registers components; may be repeated."
    ),
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace what is there.")]


def load_plugins(modules: Sequence[str] | None) -> list[str]:
    """Import the modules, from the current folder too; `ConfigError` for one that cannot be."""
    from deepir.registry import load_plugin

    if modules and (here := str(Path.cwd())) not in sys.path:
        sys.path.insert(0, here)
    for module in modules or ():
        load_plugin(module)
    return list(modules or ())
