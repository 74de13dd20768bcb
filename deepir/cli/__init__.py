"""The command line. Commands import heavy modules when they run, so that `deepir --help` is quick."""

from __future__ import annotations

import gc
import sys
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

import deepir
from deepir.cli.cameras import capture, live, simulate
from deepir.cli.checks import analyze, check, list_components
from deepir.cli.recordings import apply, calibrate, correct
from deepir.cli.runs import batch, compare, demo, resume, run, train
from deepir.cli.terminal import Interrupted, echo, notify, printed_warnings, standard_streams
from deepir.errors import DeepIRError, SolverError

#: What `deepir` alone prints.
WELCOME = """\
deepir corrects what thermal cameras record.

  deepir correct drive.avi          a recording of a moving camera
  deepir live --camera v4l2 --page  a camera, shown in the browser
  deepir demo                       a simulated burst, to see what it does

All commands: deepir --help. Options of one: deepir correct --help.
"""

#: New objects from which Python looks for garbage; by default 700, which takes a fifth of the time of all imports.
NEW_OBJECTS = 50_000

app = typer.Typer(
    help="Corrects what thermal cameras record. Try `deepir correct drive.avi`, or `deepir demo`.",
    add_completion=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
#: In the order of `deepir --help`.
COMMANDS: tuple[Callable[..., int | None], ...] = (
    *(correct, live, run, demo, capture, simulate, resume, compare, batch),
    *(calibrate, apply, list_components, check, analyze, train),
)
for each in COMMANDS:
    first_line = (each.__doc__ or "").partition("\n")[0]
    app.command(each.__name__.partition("_")[0], short_help=first_line.partition(":")[0].rstrip("."))(each)


def _version(wanted: bool) -> None:
    if wanted:
        echo(f"deepir {deepir.__version__}")
        raise typer.Exit


@app.callback()
def _options(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    pass


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: Its arguments; None: those of the process.

    Returns:
        The exit status. 0: finished. 1: the solve failed, or an internal error. 2: an error that the user can fix;
        nothing was written. 130, 143: interrupted by Ctrl-C or SIGTERM, the state is saved.
    """
    gc.set_threshold(NEW_OBJECTS)
    with standard_streams(), printed_warnings():
        try:
            Path.cwd()
        except FileNotFoundError:
            return _print_error("the current folder was deleted: go to another one", 2)
        return _run(list(sys.argv[1:] if arguments is None else arguments))


def _run(given: list[str]) -> int:
    try:
        if not given:
            print(WELCOME, end="", flush=True)
            return 0
        status = typer.main.get_command(app).main(given, prog_name="deepir", standalone_mode=False)
        sys.stdout.flush()
        return int(status or 0)
    except Interrupted as error:
        notify(error.outcome)
        return error.status
    except Exception as error:
        if hasattr(error, "format_message"):  # typer's own: an unknown command or option
            return _print_error(_usage(error.format_message(), given), 2)
        if isinstance(error, DeepIRError):
            return _print_error(str(error), 1 if isinstance(error, SolverError) else 2)
        return _report_internal_error(error)


def _print_error(message: str, status: int) -> int:
    notify(f"error: {' '.join(message.split())}")
    return status


def _usage(message: str, given: Sequence[str]) -> str:
    """A usage error with the likely intention."""
    message = message.rstrip(".")
    if message.startswith("No such option: --") and given[0] in ("run", "check", "compare", "batch"):
        from deepir.config.components import annotation_of
        from deepir.config.schema import Config

        name = message.partition("--")[2].split(" ")[0].split("=")[0]
        example = f"{name}=..." if annotation_of(Config, name) else "output.dir=FOLDER"
        return f"{message}; settings are key=value without dashes, for example {example}"
    if message.startswith("Missing argument"):
        return f"{message}; `deepir {given[0]} --help` shows what it takes"
    if given[0] == "help":
        return f"{message}; all commands: deepir --help"
    if message.startswith("No such command") and "Did you mean" not in message:
        from deepir.config import shipped_names

        if given[0] in shipped_names():
            return f"{message}; did you mean `deepir run {given[0]}`?"
        return f"{message}; there are {', '.join(typer.main.get_group(app).commands)}"
    return message


def _report_internal_error(error: Exception) -> int:
    if isinstance(error, MemoryError) or "not enough memory" in str(error) or "out of memory" in str(error):
        return _print_error("not enough memory: use a part of the frame (data.crop) or fewer frames (data.frames)", 1)
    if isinstance(error, OSError):
        return _print_error(f"{error.filename or 'files'}: {error.strerror or error}", 1)
    if not (notes := getattr(error, "__notes__", [])):  # raised where there is no log
        traceback.print_exception(error)
    what = f"{type(error).__name__}: {error}"
    return _print_error(f"internal error, please report it: {what}{''.join(f' ({note})' for note in notes)}", 1)
