"""`deepir simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepir.cli.arguments import Overwrite


def simulate(
    out: Annotated[
        Path, typer.Argument(metavar="OUT.npz", help="The burst; its truth goes to OUT_truth.npz.")
    ],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="[KEY=VALUE]...", help="Settings, for example n_frames=8 counts=true"),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="PICTURE",
            help="A file, a picture of scikit-image (camera), procedural:SEED or sky:SEED; finer than the detector.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of motion, pattern, noise, and the scene that is drawn.")
    ] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a burst with known truth: deepir simulate burst.npz n_frames=8 shape=[240,320] counts=true."""
    from deepir import simulate as camera
    from deepir.config.overrides import split
    from deepir.errors import DataError
    from deepir.simulate.pictures import picture
    from deepir.simulate.settings import parse, schema

    checked = parse(dict(split(settings or [], schema())))
    truth = out.with_name(f"{out.stem}_truth.npz")
    for path in (out, truth):
        if path.exists() and not overwrite:
            raise DataError(f"{path} exists; replace it with --overwrite, or give another name")
    if out.suffix != ".npz" or not out.parent.is_dir():
        raise DataError(f"{out}: give the name of an .npz file in a folder that exists")
    camera.simulate(None if scene is None else picture(scene), checked, seed=seed).save(out)
    typer.echo(
        f"{out}: {checked.n_frames} frames of {checked.shape[0]} x {checked.shape[1]} px; truth: {truth}"
    )
