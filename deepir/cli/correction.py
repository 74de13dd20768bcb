"""A recording corrected into files."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

from deepir.cli.arguments import recording_radiometry
from deepir.cli.terminal import Interrupted, echo, notify
from deepir.messages import labelled

if TYPE_CHECKING:
    from deepir.config import Config
    from deepir.recording.correct import CorrectedRecording


def correct_file(
    config: Config, target: Path, maps: Path, picture: Path, page: Path, *, rounded: bool, quiet: bool = False
) -> CorrectedRecording:
    """Estimate the sensor, then write maps, picture, report and all corrected frames.

    Args:
        config: Of how the recording is read and displayed.
        target: The corrected recording to write.
        maps: The file for the maps.
        picture: The file for the picture.
        page: The file for the report.
        rounded: Whether values are rounded to the recording's type.
        quiet: Whether nothing is printed.

    Returns:
        The corrected recording.
    """
    import functools
    from concurrent.futures import ThreadPoolExecutor

    from deepir.correct_recording import sensor_of_burst
    from deepir.io import atomic_files, stream_data
    from deepir.io.output import open_writer, output_type, write_frames
    from deepir.io.radiometry import unit_metadata
    from deepir.recording.correct import CorrectedRecording, findings_lines
    from deepir.report.panels import write_correction
    from deepir.report.progress import track
    from deepir.report.recording import write_recording_report

    data, shown = config.data, config.output
    begun = time.perf_counter()
    read = functools.partial(stream_data, data)
    dtype = output_type(next(read()).dtype, rounded=rounded)
    metadata = unit_metadata(recording_radiometry(config))
    writer = open_writer(target, dtype, metadata, shown.palette, shown.tones)
    follow: Any = (lambda frames, *_: frames) if quiet else track
    corrected = CorrectedRecording.of(read, lambda frames: follow(frames, "reading"), sensor_of_burst)
    with atomic_files(maps, picture, page) as (own_maps, own_picture, own_page):
        corrected.save_maps(own_maps)
        if not quiet:
            _describe(corrected)
        try:
            with ThreadPoolExecutor(1) as beside, writer as write:
                drawn = beside.submit(write_correction, own_picture, corrected)
                count = write_frames(follow(iter(corrected), "correcting", len(corrected)), write)
                drawn.result()
                findings = list(findings_lines(corrected.estimate))
                unit = str(metadata.get("unit", "counts" if dtype.kind in "iu" else ""))
                write_recording_report(own_page, corrected, str(data.path), unit, findings)
        except Interrupted:
            if not maps.exists():
                own_maps.replace(maps)  # all that the rest needs
            raise
    if quiet:
        return corrected
    for line in findings:
        echo(line)
    speed = count / (time.perf_counter() - begun)
    echo(f"{target}: {count} frame(s), corrected at {speed:.0f} frames/s; maps: {maps}; to look at: {page}, {picture}")
    return corrected


def _describe(corrected: CorrectedRecording) -> None:
    """Print what is corrected, and warnings."""
    segments = corrected.segments
    if len(segments) > 1:
        echo(f"the fixed pattern jumps {len(segments) - 1} time(s), as after a closure of the shutter:")
        for each in segments:
            echo(f"  {each.description}")
    known, bad = len(corrected.keyframes.frames), int(corrected.estimate.bad_pixels.sum())
    echo(f"correction: {corrected.estimate.kept}, from {known} of {len(corrected)} frames; {bad} bad pixels")
    for line in labelled(corrected.messages):
        notify(line)
