"""`deepir apply`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import (
    RECORDING_SETTINGS,
    Overwrite,
    ReadingSettings,
    held_outputs,
    recording_config,
    recording_radiometry,
)
from deepir.cli.terminal import echo, notify

if TYPE_CHECKING:
    from deepir.calibration import CorrectionMaps
    from deepir.config import Config

MAX_ROUGHNESS_RATIO = 1.3  # roughness after correction over before, above which the maps do not fit


def apply(
    maps: Annotated[
        Path, typer.Argument(metavar="MAPS", help="Maps of `deepir calibrate`, or the folder of a run.")
    ],
    file: Annotated[str, typer.Argument(metavar="FILE", help="A recording of the same camera.")],
    settings: ReadingSettings = None,
    output: Annotated[
        Path | None,
        typer.Option(
            help="A .tif, or an .mp4 to look at; FILE_corrected.tif unless given.", show_default=False
        ),
    ] = None,
    float32: Annotated[bool, typer.Option("--float32", help="Do not round to the recording's type.")] = False,
    overwrite: Overwrite = False,
) -> int:
    """Correct a whole recording, frame by frame: deepir apply maps.npz flight.seq --output flight.mp4.

    The recording may be larger than the memory. Settings: data.key, data.raw, data.axes, data.crop, data.swap_bytes,
    data.radiometry, output.palette, output.tones.
    """
    from deepir.calibration import read_maps
    from deepir.cli.terminal import Interrupted, Interruptible, report_aborted
    from deepir.messages import shown

    config = recording_config(file, settings or (), RECORDING_SETTINGS)
    target = output or Path(f"{Path(file).stem}_corrected.tif")
    try:
        with Interruptible(), held_outputs(target, overwrite=overwrite, source=config.data.path):
            found = read_maps(maps)
            for line in shown(_messages(maps), f"{maps}/report.html"):
                notify(f"{maps}: {line}")
            echo(_apply(found, config, target, rounded=not float32))
    except Interrupted as error:
        return report_aborted(error)
    return 0


def _messages(maps: Path) -> list[str]:
    """The messages of the run in a folder, labelled; none of maps that are a file."""
    import json

    try:
        found = json.loads((maps / "metrics.json").read_text(encoding="utf-8"))
        return [str(each) for each in found["messages"]]
    except (OSError, ValueError, KeyError, TypeError):
        return []


def _apply(maps: CorrectionMaps, config: Config, target: Path, *, rounded: bool) -> str:
    """Write all frames; a line with the result."""
    import itertools

    from deepir.io import stream_data
    from deepir.io.output.recording import open_writer, output_type, write_frames
    from deepir.io.radiometry import unit_metadata

    data, shown = config.data, config.output
    frames = stream_data(data)
    first = next(frames)
    maps.check(first, str(data.path))
    if (ratio := maps.roughness_ratio(first)) > MAX_ROUGHNESS_RATIO:
        echo(
            f"{data.path}: its first frame is {ratio:.1f} times as rough without these maps' pattern as with it. "
            "Are they of another camera, in other units (counts, kelvin, 8 bits), or out of date?",
            err=True,
        )
    dtype = output_type(first.dtype, rounded=rounded)
    begun = time.perf_counter()
    with open_writer(
        target, dtype, unit_metadata(recording_radiometry(config)), shown.palette, shown.tones
    ) as write:
        count = write_frames(map(maps.correct, itertools.chain([first], frames)), write)
    speed = count / (time.perf_counter() - begun)
    return f"{target}: {count} frame(s) of {' x '.join(map(str, first.shape))} px, {speed:.0f} frames/s"
