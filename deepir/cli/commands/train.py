"""`deepir train`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, Plugins, check_output_name, held_outputs, load_plugins
from deepir.cli.terminal import echo

if TYPE_CHECKING:
    from deepir.training.training import TrainingProgress

REPORT_INTERVAL = 250  # iterations between two lines of progress


def train(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="What to train: see `deepir list`.", show_default=False)
    ],
    out: Annotated[
        Path | None,
        typer.Option(metavar="FILE.safetensors", help="File of the weights; default: NAME.safetensors."),
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
    check_output_name(path, ".safetensors")
    torch.set_num_threads(threads)
    about = {"training": name, "seed": seed, "iterations": iterations or kind.iterations, "threads": threads}
    about |= {"deepir": deepir.__version__, "torch": torch.__version__}
    with held_outputs(path, overwrite=overwrite):
        network = training.train(kind, seed=seed, iterations=iterations, report=_report_progress)
        weights.save(network, path, about)
    echo(f"weights: {path}")


def _report_progress(now: TrainingProgress) -> None:
    if now.iteration % REPORT_INTERVAL == 0 or now.iteration == now.iterations:
        left = now.seconds / now.iteration * (now.iterations - now.iteration)
        echo(f"{now.iteration}/{now.iterations}: loss {now.loss:.4f}, about {left:.0f} s to go", err=True)
