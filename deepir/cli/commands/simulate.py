"""`deepir simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite
from deepir.cli.outputs import held_outputs
from deepir.cli.terminal import echo

if TYPE_CHECKING:
    from deepir.simulate import Simulation
    from deepir.simulate.recording import Recording


def simulate(
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT.npz", help="The burst or recording; its truth goes to OUT_truth.npz."),
    ],
    settings: Annotated[
        list[str] | None,
        typer.Argument(metavar="KEY=VALUE", help="Settings, for example n_frames=8 counts=true; kind=drive"),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            metavar="PICTURE",
            help="A file, a picture of scikit-image (camera), procedural:SEED or sky:SEED; finer than the detector.",
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Seed of motion, pattern, noise and drawn scene.")] = 0,
    overwrite: Overwrite = False,
) -> None:
    """Simulate a burst with known truth: deepir simulate burst.npz n_frames=8 shape=[240,320] counts=true.

    With a kind, a whole recording: deepir simulate drive.npz kind=drive n_frames=300 (walk, pan, tripod, drone).
    """
    from deepir import simulate as camera
    from deepir.config.overrides import parse_settings
    from deepir.errors import DataError
    from deepir.simulate.scenes.pictures import load_picture
    from deepir.simulate.settings import checked_values, settings_from_mapping, settings_schema

    made: Simulation | Recording
    given = settings or []
    if whole := any(each.partition("=")[0].strip() == "kind" for each in given):
        from deepir.simulate.recording import RecordingSettings, simulate_recording

        pairs = dict(parse_settings(given, settings_schema(of=RecordingSettings)))
        asked = RecordingSettings(**checked_values(pairs, RecordingSettings, "recording"))
    else:
        burst = settings_from_mapping(dict(parse_settings(given, settings_schema())))
    truth = out.with_name(f"{out.stem}_truth.npz")
    if out.suffix != ".npz" or not out.parent.is_dir():
        raise DataError(f"{out}: give the name of an .npz file in a folder that exists")
    if whole and scene is not None:
        raise DataError("--scene: the world of a recording is drawn; leave it out, or leave out kind")
    with held_outputs(out, truth, overwrite=overwrite):
        if whole:
            made = simulate_recording(asked, seed=seed)
        else:
            made = camera.simulate(None if scene is None else load_picture(scene), burst, seed=seed)
        made.save(out)
    count, height, width = made.frames.shape
    echo(f"{out}: {count} frames of {height} x {width} px; truth: {truth}")
