"""`deepir simulate`."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, check_output_name, held_outputs
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
    from deepir.errors import DataError

    given = settings or []
    whole = any(each.partition("=")[0].strip() == "kind" for each in given)
    simulated: Callable[[], Simulation | Recording]
    simulated = _recording(given, seed) if whole else _burst(given, scene, seed)
    check_output_name(out, ".npz")
    if whole and scene is not None:
        raise DataError("--scene: the world of a recording is drawn; leave it out, or leave out kind")
    truth = out.with_name(f"{out.stem}_truth.npz")
    with held_outputs(out, truth, overwrite=overwrite):
        made = simulated()
        made.save(out)
    count, height, width = made.frames.shape
    echo(f"{out}: {count} frames of {height} x {width} px; truth: {truth}")


def _burst(settings: list[str], scene: str | None, seed: int) -> Callable[[], Simulation]:
    """Check the settings of a burst; a function that simulates it."""
    from deepir import simulate as camera
    from deepir.config.overrides import parse_settings
    from deepir.simulate.scenes.pictures import load_picture
    from deepir.simulate.settings import settings_from_mapping, settings_schema

    burst = settings_from_mapping(dict(parse_settings(settings, settings_schema())))
    return lambda: camera.simulate(None if scene is None else load_picture(scene), burst, seed=seed)


def _recording(settings: list[str], seed: int) -> Callable[[], Recording]:
    """Check the settings of a whole recording; a function that simulates it."""
    from deepir.config.overrides import parse_settings
    from deepir.simulate.recording import RecordingSettings, simulate_recording
    from deepir.simulate.settings import checked_values, settings_schema

    pairs = dict(parse_settings(settings, settings_schema(of=RecordingSettings)))
    recording = RecordingSettings(**checked_values(pairs, RecordingSettings, "recording"))
    return lambda: simulate_recording(recording, seed=seed)
