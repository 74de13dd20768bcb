"""`deepir analyze`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, Settings, recording_config
from deepir.cli.terminal import echo, notify

if TYPE_CHECKING:
    from deepir.analysis import BurstAssessment, PatternStatistics
    from deepir.result import Array

JUDGED = ("gain", "offset", "scene", "motion", "bad_pixels")  # arrays of a result


def analyze(
    what: Annotated[str, typer.Argument(metavar="FILE|RUN", help="A burst, or the folder of a run.")],
    settings: Settings = None,
    flat: Annotated[bool, typer.Option("--flat", help="The frames are of a uniform source.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(help="File of the picture; default: runs/NAME-analysis.png, or RUN/analysis.png."),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Report the jitter and the frames that a camera needs: deepir analyze burst.npz, or shutter.npz --flat.

    A burst is solved first, with the settings of `deepir run nuc`, and rated. With --flat, settings are those of the
    file's format.
    """
    from deepir.analysis import report_lines
    from deepir.errors import ConfigError, DataError
    from deepir.paths import expanded
    from deepir.report.panels import write_analysis

    path = expanded(what)
    if output is not None and output.suffix != ".png":
        raise ConfigError(f"--output {output}: a picture's name ends in .png")
    if output is not None and output.exists() and not overwrite:
        raise DataError(f"{output} exists; replace it with --overwrite, or give another name")
    statistics, assessment, scene_deviation = _analysis(path, settings or [], flat=flat)
    for line in report_lines(statistics, assessment, scene_deviation):
        echo(line)
    picture = output or _default_picture(path)
    _make_folder(picture.parent)
    write_analysis(picture, statistics, assessment, scene_deviation)
    echo(f"picture: {picture}")


def _is_run(path: Path) -> bool:
    return (path / "result.npz").is_file()


def _default_picture(path: Path) -> Path:
    return path / "analysis.png" if _is_run(path) else Path("runs") / f"{path.stem}-analysis.png"


def _make_folder(folder: Path) -> None:
    from deepir.errors import DataError

    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise DataError(f"{folder}: cannot be written: {error.strerror}") from None


def _analysis(
    path: Path, settings: list[str], *, flat: bool
) -> tuple[PatternStatistics, BurstAssessment | None, Array | None]:
    """Statistics of the pattern; assessment of the burst and deviation of the scene, where they are known."""
    from deepir.errors import ConfigError

    if flat:
        return _of_flat(path, settings), None, None
    if _is_run(path) and settings:
        raise ConfigError(f"{path}: a finished run takes no settings")
    arrays, scene_deviation = _of_run(path) if _is_run(path) else _of_burst(path, settings)
    return *_judged(**arrays), scene_deviation


def _of_flat(path: Path, settings: list[str]) -> PatternStatistics:
    from deepir.analysis import flat_statistics
    from deepir.burst import load

    flat = load(recording_config(str(path), settings, ("data",)).data, needs=2)
    return flat_statistics(flat.frames, flat.valid.all(0) & ~flat.bad_pixels)


def _of_burst(path: Path, settings: list[str]) -> tuple[dict[str, Array], Array | None]:
    """Arrays of the result of a burst, and the deviation of its scene."""
    import deepir
    from deepir.cli.terminal import watched_solve
    from deepir.messages import labelled, shown

    with watched_solve() as callbacks:
        result = deepir.run("nuc", *settings, f"data.path={path}", output={}, callbacks=callbacks)
    for line in shown(labelled(result.messages), f"the report of `deepir run nuc data.path={path}`"):
        notify(line)
    return {name: getattr(result, name) for name in JUDGED}, result.uncertainty.get("scene")


def _of_run(path: Path) -> tuple[dict[str, Array], Array | None]:
    """The same of a run in a folder."""
    import numpy as np

    from deepir.errors import DataError

    with np.load(path / "result.npz") as stored:
        found = {name: stored[name] for name in JUDGED}
    if found["gain"].ndim > 2:
        raise DataError(f"{path}: a result of {len(found['gain'])} bands; analyse a run of one of them, frames[:, 0]")
    beside, scene_deviation = path / "uncertainty.npz", None
    if beside.exists():
        with np.load(beside) as stored:
            # With a scene for each frame there is no single map.
            scene_deviation = stored["scene"] if stored["scene"].ndim == 2 else None
    return found, scene_deviation


def _judged(
    gain: Array, offset: Array, scene: Array, motion: Array, bad_pixels: Array
) -> tuple[PatternStatistics, BurstAssessment | None]:
    """Statistics of the pattern of a result at the mean flux, and the assessment of its burst."""
    import numpy as np

    from deepir.analysis import assess_burst, map_statistics

    pattern = (gain - 1.0) * scene.mean(dtype=np.float64) + offset
    statistics = map_statistics(pattern, ~bad_pixels)
    finer = scene.shape[-2] / len(gain)  # px of the scene in one of the detector
    coarser = np.diag([1 / finer, 1 / finer, 1])
    seen = motion[np.isfinite(motion).all((1, 2))]
    if len(seen) < 2 or scene.ndim > 2:  # no motion across the pattern
        return statistics, None
    return statistics, assess_burst(statistics, coarser @ seen @ np.linalg.inv(coarser), round(finer))
