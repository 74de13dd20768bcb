"""`deepir simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite

if TYPE_CHECKING:
    import numpy as np

    from deepir.simulate import Settings


def simulate(
    out: Annotated[
        Path, typer.Argument(metavar="OUT.npz", help="The burst; its truth goes to OUT_truth.npz.")
    ],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="[KEY=VALUE]...", help="Settings, for example n_frames=8 counts=true"),
    ] = None,
    scene: Annotated[
        Path | None,
        typer.Option(metavar="PICTURE", help="A picture, finer than the detector; its range becomes 0 to 1."),
    ] = None,
    seed: Annotated[
        int, typer.Option(min=0, help="Of motion, pattern, noise, and the scene that is drawn.")
    ] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a burst with known truth: deepir simulate burst.npz n_frames=8 shape=[240,320] counts=true."""
    from deepir import simulate as camera
    from deepir.errors import DataError

    checked = parse_settings(settings or [])
    truth = out.with_name(f"{out.stem}_truth.npz")
    for path in (out, truth):
        if path.exists() and not overwrite:
            raise DataError(f"{path} exists; replace it with --overwrite, or give another name")
    if out.suffix != ".npz" or not out.parent.is_dir():
        raise DataError(f"{out}: give the name of an .npz file in a folder that exists")
    picture = None if scene is None else _picture(scene)
    camera.simulate(picture, checked, seed=seed).save(out)
    typer.echo(
        f"{out}: {checked.n_frames} frames of {checked.shape[0]} x {checked.shape[1]} px; truth: {truth}"
    )


def parse_settings(pairs: list[str]) -> Settings:
    """`simulate.Settings` from key=value; `ConfigError` for what does not fit."""
    import typing
    from dataclasses import fields

    from pydantic import ConfigDict, ValidationError, create_model

    from deepir.components import explain
    from deepir.errors import ConfigError
    from deepir.overrides import split
    from deepir.simulate import Settings

    hints = typing.get_type_hints(Settings)
    known: typing.Any = {each.name: (hints[each.name], each.default) for each in fields(Settings)}
    schema = create_model("Settings", __config__=ConfigDict(extra="forbid"), **known)
    try:
        found = schema.model_validate(
            {key: value for key, value in split(pairs, schema) if value is not None}
        )
    except ValidationError as error:
        raise ConfigError(f"simulate: {explain(error, schema)[1]}") from None
    return Settings(**{name: getattr(found, name) for name in known})


def _picture(path: Path) -> np.ndarray:
    import numpy as np

    from deepir.errors import DataError
    from deepir.io import read_frames

    frames = read_frames(path).frames
    low, high = np.nanmin(frames[0]), np.nanmax(frames[0])
    if len(frames) != 1 or not np.isfinite(frames).all() or not high > low:
        raise DataError(f"{path}: a scene is one picture, finite and not constant")
    return ((frames[0] - low) / (high - low)).astype(np.float64)
