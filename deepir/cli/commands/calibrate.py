"""`deepir calibrate`."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import (
    DATA_SETTINGS,
    Overwrite,
    check_output_name,
    held_outputs,
    recording_config,
    split_arguments,
)
from deepir.cli.terminal import echo

if TYPE_CHECKING:
    from deepir.calibration import CorrectionMaps

MOTION_CHECK_FRAMES = 8  # first frames of a flat recording that are checked for motion


def calibrate(
    out: Annotated[Path, typer.Argument(metavar="OUT.npz", help="The maps.")],
    what: Annotated[
        list[str],
        typer.Argument(
            metavar="FLAT|KEY=VALUE",
            help="Recordings of something uniform, each of another temperature; settings such as data.key=raw.",
            show_default=False,
        ),
    ],
    burst: Annotated[
        bool, typer.Option("--burst", help="The recording is a burst of a moving camera.")
    ] = False,
    overwrite: Overwrite = False,
) -> int:
    """Estimate a camera's gain, offset and bad pixels: deepir calibrate maps.npz cold.npz hot.npz.

    One flat recording gives the offset, two or more the gain too. With --burst both come from the scene's motion.
    """
    from deepir.errors import DataError

    files, settings = split_arguments(what)
    check_output_name(out, ".npz")
    if not files or (burst and len(files) > 1):
        raise DataError(f"{len(files)} recordings given: one with --burst, else one or more flat ones")
    with held_outputs(out, overwrite=overwrite):
        maps = _from_burst(files[0], settings) if burst else _from_flats(files, settings)
        if isinstance(maps, int):
            return maps
        maps.save(out)
    good = ~maps.bad_pixels
    echo(
        f"{out}: gain σ {100 * maps.gain[good].std():.2f} %, offset σ {maps.offset[good].std():.4g}, "
        f"{maps.bad_pixels.sum()} bad pixel(s)"
    )
    echo(f"to correct a recording: deepir apply {out} FILE")
    return 0


def _from_flats(files: Sequence[str], settings: Sequence[str]) -> CorrectionMaps:
    import itertools

    import numpy as np

    from deepir import calibration
    from deepir.io import stream_data
    from deepir.io.inspection.describe import visible_motion

    means = []
    for file in files:
        data = recording_config(file, settings, DATA_SETTINGS).data
        frames = stream_data(data)
        first = list(itertools.islice(frames, MOTION_CHECK_FRAMES))
        means.append(calibration.mean_frame(itertools.chain(first, frames), file))
        if visible_motion(np.stack([np.ma.filled(frame.astype(float), np.nan) for frame in first])):
            echo(
                f"{file}: its frames change as with a moving camera, but a flat recording shows a uniform surface. "
                "For a burst of a moving camera, give --burst",
                err=True,
            )
    return calibration.maps_from_flats(means, files)


def _from_burst(file: str, settings: Sequence[str]) -> CorrectionMaps | int:
    from deepir.calibration import CorrectionMaps
    from deepir.cli.terminal import Interrupted, Interruptible, report_aborted
    from deepir.config import load
    from deepir.report.progress import show_progress
    from deepir.runner import execute, prepare

    config = load("nuc", [f"data.path={file}", *settings])
    try:
        with Interruptible() as interruptible, show_progress() as progress:
            result = execute(config, prepare(config), callbacks=(interruptible, progress))
    except Interrupted as error:
        return report_aborted(error)
    return CorrectionMaps(result.gain, result.offset, result.bad_pixels)
