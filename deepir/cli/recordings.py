"""Commands that correct recordings: `correct`, and `calibrate` and `apply`, with maps of a camera."""

from __future__ import annotations

import itertools
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import (
    DATA_SETTINGS,
    RECORDING_SETTINGS,
    CorrectedOutput,
    Float32,
    Overwrite,
    ReadingSettings,
    held_outputs,
    recording_config,
    recording_radiometry,
    split_arguments,
)
from deepir.cli.terminal import Interrupted, Interruptible, echo, notify, watched_solve
from deepir.errors import ConfigError, DataError

if TYPE_CHECKING:
    from deepir.calibration import CorrectionMaps
    from deepir.config import Config

MAX_ROUGHNESS_RATIO = 1.3  # roughness after correction over before, above which the maps do not fit


def correct(
    file: Annotated[str, typer.Argument(metavar="FILE", help="A recording of a camera that moves.")],
    settings: ReadingSettings = None,
    output: CorrectedOutput = None,
    float32: Float32 = False,
    overwrite: Overwrite = False,
    output_dir: Annotated[
        Path | None, typer.Option(help="Correct many: FILE is a folder of recordings, or a list of them (.txt).")
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
        if output is not None:
            raise ConfigError("--output is of one recording; with --output-dir leave it out")
        from deepir.cli.correction import correct_all

        return correct_all(file, settings or (), output_dir, shard, rounded=not float32, overwrite=overwrite)
    config = recording_config(file, settings or (), RECORDING_SETTINGS)
    target = output or Path(f"{Path(file).stem}_corrected.tif")
    maps, picture, page = (target.with_name(f"{target.stem}{end}") for end in ("_maps.npz", ".png", ".html"))
    known = maps.exists()
    try:
        with Interruptible(), held_outputs(target, maps, picture, page, overwrite=overwrite, source=config.data.path):
            from deepir.cli.correction import correct_file

            correct_file(config, target, maps, picture, page, rounded=not float32)
    except Interrupted as error:
        if maps.exists() and not known:
            error.outcome = f"interrupted; go on with: deepir apply {maps} {file}"
        raise
    return 0


def apply(
    maps: Annotated[Path, typer.Argument(metavar="MAPS", help="Maps of `deepir calibrate`, or the folder of a run.")],
    file: Annotated[str, typer.Argument(metavar="FILE", help="A recording of the same camera.")],
    settings: ReadingSettings = None,
    output: CorrectedOutput = None,
    float32: Float32 = False,
    overwrite: Overwrite = False,
) -> None:
    """Correct a whole recording, frame by frame: deepir apply maps.npz flight.seq --output flight.mp4.

    The recording may be larger than the memory. Settings: data.key, data.raw, data.axes, data.crop, data.swap_bytes,
    data.radiometry, output.palette, output.tones.
    """
    from deepir.calibration import read_maps
    from deepir.messages import shown

    config = recording_config(file, settings or (), RECORDING_SETTINGS)
    target = output or Path(f"{Path(file).stem}_corrected.tif")
    with Interruptible(), held_outputs(target, overwrite=overwrite, source=config.data.path):
        found = read_maps(maps)
        for line in shown(_messages(maps), f"{maps}/report.html"):
            notify(f"{maps}: {line}")
        echo(_apply(found, config, target, rounded=not float32))


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
    from deepir.io import stream_data
    from deepir.io.output import open_writer, output_type, write_frames
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
    with open_writer(target, dtype, unit_metadata(recording_radiometry(config)), shown.palette, shown.tones) as write:
        count = write_frames(map(maps.correct, itertools.chain([first], frames)), write)
    speed = count / (time.perf_counter() - begun)
    return f"{target}: {count} frame(s) of {' x '.join(map(str, first.shape))} px, {speed:.0f} frames/s"


def calibrate(
    out: Annotated[Path, typer.Argument(metavar="OUT.npz", help="The maps.")],
    what: Annotated[
        list[str],
        typer.Argument(
            metavar="FLAT|KEY=VALUE",
            help="Recordings of something uniform, each of another temperature; settings such as data.key=raw.",
        ),
    ],
    burst: Annotated[bool, typer.Option("--burst", help="The recording is a burst of a moving camera.")] = False,
    overwrite: Overwrite = False,
) -> None:
    """Estimate a camera's gain, offset and bad pixels: deepir calibrate maps.npz cold.npz hot.npz.

    One flat recording gives the offset, two or more the gain too. With --burst both come from the scene's motion.
    """
    files, settings = split_arguments(what)
    if not files or (burst and len(files) > 1):
        raise DataError(f"{len(files)} recordings given: one with --burst, else one or more flat ones")
    with Interruptible(), held_outputs(out, overwrite=overwrite, suffix=".npz"):
        maps = _from_burst(files[0], settings) if burst else _from_flats(files, settings)
        maps.save(out)
    good = ~maps.bad_pixels
    echo(
        f"{out}: gain σ {100 * maps.gain[good].std():.2f} %, offset σ {maps.offset[good].std():.4g}, "
        f"{maps.bad_pixels.sum()} bad pixel(s)"
    )
    echo(f"to correct a recording: deepir apply {out} FILE")


def _from_flats(files: Sequence[str], settings: Sequence[str]) -> CorrectionMaps:
    import numpy as np

    from deepir import calibration
    from deepir.io import stream_data
    from deepir.io.inspection.describe import visible_motion

    means = []
    for file in files:
        data = recording_config(file, settings, DATA_SETTINGS).data
        frames = stream_data(data)
        first = list(itertools.islice(frames, 8))  # are checked for motion
        means.append(calibration.mean_frame(itertools.chain(first, frames), file))
        if visible_motion(np.stack([np.ma.filled(frame.astype(float), np.nan) for frame in first])):
            echo(
                f"{file}: its frames change as with a moving camera, but a flat recording shows a uniform surface. "
                "For a burst of a moving camera, give --burst",
                err=True,
            )
    return calibration.maps_from_flats(means, files)


def _from_burst(file: str, settings: Sequence[str]) -> CorrectionMaps:
    from deepir.calibration import CorrectionMaps
    from deepir.config import load
    from deepir.runner import execute, prepare

    config = load("nuc", [f"data.path={file}", *settings])
    with watched_solve() as callbacks:
        result = execute(config, prepare(config), callbacks=callbacks)
    return CorrectionMaps(result.gain, result.offset, result.bad_pixels)
