"""`deepir correct`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from deepir.cli.arguments import (
    RECORDING_SETTINGS,
    CorrectedOutput,
    Float32,
    Overwrite,
    ReadingSettings,
    held_outputs,
    recording_config,
)
from deepir.cli.correction import correct_file
from deepir.cli.terminal import Interrupted, Interruptible
from deepir.errors import ConfigError


def correct(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A recording of a camera that moves.")],
    settings: ReadingSettings = None,
    output: CorrectedOutput = None,
    float32: Float32 = False,
    overwrite: Overwrite = False,
    output_dir: Annotated[
        Path | None,
        typer.Option(help="Correct many: FILE is a folder of recordings, or a list of them (.txt)."),
    ] = None,
    shard: Annotated[str, typer.Option(metavar="I/N", help="With --output-dir: the I-th of N parts.")] = "1/1",
) -> int:
    """Correct a whole recording of a moving camera: deepir correct drive.avi.

    Writes the corrected recording, the camera's maps (OUTPUT_maps.npz, for `deepir apply`), and to look at a report
    (OUTPUT.html) and a picture (OUTPUT.png).
    The recording may be larger than the memory. Settings: data.key, data.frames, data.raw, data.axes, data.crop,
    data.swap_bytes, data.radiometry, output.palette, output.tones.

    deepir correct FOLDER --output-dir DIR corrects all recordings of a folder; one JSON line each. What is done already
    is skipped, so the same command goes on where it was interrupted.
    """
    if output_dir is not None:
        from deepir.cli.archive import correct_all

        if output is not None:
            raise ConfigError("--output is of one recording; with --output-dir leave it out")
        return correct_all(file, settings or (), output_dir, shard, rounded=not float32, overwrite=overwrite)
    config = recording_config(file, settings or (), RECORDING_SETTINGS)
    target = output or Path(f"{Path(file).stem}_corrected.tif")
    maps, picture, page = (target.with_name(f"{target.stem}{end}") for end in ("_maps.npz", ".png", ".html"))
    outputs = (target, maps, picture, page)
    known = maps.exists()
    try:
        with Interruptible(), held_outputs(*outputs, overwrite=overwrite, source=config.data.path):
            correct_file(config, *outputs, rounded=not float32)
    except Interrupted as error:
        if maps.exists() and not known:
            error.outcome = f"interrupted; go on with: deepir apply {maps} {file}"
        raise
    return 0
