"""`deepir correct`."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepir.cli.arguments import (
    RECORDING_SETTINGS,
    CorrectedOutput,
    Float32,
    Overwrite,
    ReadingSettings,
    held_outputs,
    recording_config,
    recording_radiometry,
)
from deepir.cli.terminal import Interrupted, Interruptible, echo, notify
from deepir.errors import ConfigError
from deepir.messages import labelled

if TYPE_CHECKING:
    from deepir.config import Config
    from deepir.recording.correct import CorrectedRecording
    from deepir.recording.estimate import SensorEstimate


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
    shard: Annotated[
        str, typer.Option(metavar="I/N", help="With --output-dir: the I-th of N parts.")
    ] = "1/1",
) -> int:
    """Correct a whole recording of a moving camera: deepir correct drive.avi.

    Writes the corrected recording, the camera's maps (OUTPUT_maps.npz, for `deepir apply`) and a picture (OUTPUT.png).
    The recording may be larger than the memory. Settings: data.key, data.raw, data.axes, data.crop, data.swap_bytes,
    data.radiometry, output.palette, output.tones.

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
    maps, picture = (target.with_name(f"{target.stem}{end}") for end in ("_maps.npz", ".png"))
    outputs = (target, maps, picture)
    known = maps.exists()
    try:
        with Interruptible(), held_outputs(*outputs, overwrite=overwrite, source=config.data.path):
            correct_file(config, *outputs, rounded=not float32)
    except Interrupted as error:
        if maps.exists() and not known:
            error.outcome = f"interrupted; go on with: deepir apply {maps} {file}"
        raise
    return 0


def correct_file(
    config: Config, target: Path, maps: Path, picture: Path, *, rounded: bool, quiet: bool = False
) -> CorrectedRecording:
    """Estimate the sensor, then write maps, picture and all corrected frames.

    Args:
        config: Of how the recording is read and displayed.
        target: The corrected recording to write.
        maps: The file for the maps.
        picture: The file for the picture.
        rounded: Whether values are rounded to the recording's type.
        quiet: Whether nothing is printed.

    Returns:
        The corrected recording.
    """
    import functools
    from concurrent.futures import ThreadPoolExecutor

    from deepir.correct_recording import sensor_of_burst
    from deepir.io import atomic_files, stream_data
    from deepir.io.output.recording import open_writer, output_type, write_frames
    from deepir.io.radiometry import unit_metadata
    from deepir.recording.correct import CorrectedRecording, findings_lines
    from deepir.report.panels import write_correction
    from deepir.report.progress import track

    data, shown = config.data, config.output
    begun = time.perf_counter()
    read = functools.partial(stream_data, data)
    dtype = output_type(next(read()).dtype, rounded=rounded)
    metadata = unit_metadata(recording_radiometry(config))
    writer = open_writer(target, dtype, metadata, shown.palette, shown.tones)
    follow: Any = (lambda frames, *_: frames) if quiet else track
    corrected = CorrectedRecording.of(read, lambda frames: follow(frames, "reading"), sensor_of_burst)
    with atomic_files(maps, picture) as (own_maps, own_picture):
        corrected.save_maps(own_maps)
        if not quiet:
            _describe(corrected)
        try:
            with ThreadPoolExecutor(1) as beside, writer as write:
                drawn = beside.submit(write_correction, own_picture, corrected)
                lag = beside.submit(lambda: corrected.lag)
                count = write_frames(follow(iter(corrected), "correcting", len(corrected)), write)
                drawn.result()
                findings = list(findings_lines(corrected.estimate, lag.result()))
        except Interrupted:
            if not maps.exists():
                own_maps.replace(maps)  # all that the rest needs
            raise
    if quiet:
        return corrected
    for line in findings:
        echo(line)
    speed = count / (time.perf_counter() - begun)
    echo(f"{target}: {count} frame(s), {speed:.0f} frames/s; maps: {maps}; picture: {picture}")
    return corrected


def _describe(corrected: CorrectedRecording) -> None:
    """Print what is corrected, and warnings."""
    segments = corrected.segments
    if len(segments) > 1:
        echo(f"the fixed pattern jumps {len(segments) - 1} time(s), as after a closure of the shutter:")
        for each in segments:
            echo(f"  {each.description}")
    echo(_summary(corrected.estimate, len(corrected.keyframes.frames), len(corrected)))
    found = [each for part in segments if part.estimate for each in part.estimate.messages]
    for line in labelled(dict.fromkeys(found)):
        notify(line)


def _summary(estimate: SensorEstimate, keyframes: int, length: int) -> str:
    bad = int(estimate.bad_pixels.sum())
    return f"correction: {estimate.kept}, from {keyframes} of {length} frames; {bad} bad pixels"
