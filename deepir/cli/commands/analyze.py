"""`deepir analyze`."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from deepir.cli.arguments import Overwrite, Settings, recording_config

if TYPE_CHECKING:
    from deepir.analysis import Statistics, Verdict
    from deepir.result import Array


def analyze(
    what: Annotated[
        str, typer.Argument(metavar="FILE|RUN", help="A burst, or the folder of a run.", show_default=False)
    ],
    settings: Settings = None,
    flat: Annotated[bool, typer.Option("--flat", help="The frames are of a uniform source.")] = False,
    output: Annotated[
        Path | None,
        typer.Option(help="The picture; runs/NAME-analysis.png, or RUN/analysis.png.", show_default=False),
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Say how much jitter and how many frames a camera wants: deepir analyze burst.npz, or shutter.npz --flat.

    A burst is solved first (settings are those of `deepir run nuc`), and it is said whether it suffices; of a uniform
    source, settings say how the file is read.
    """
    from deepir.analysis.verdict import report_lines
    from deepir.errors import ConfigError, DataError
    from deepir.paths import expanded
    from deepir.report.analysis import write_analysis

    path = expanded(what)
    if output is not None and output.suffix != ".png":
        raise ConfigError(f"--output {output}: a picture's name ends in .png")
    if output is not None and output.exists() and not overwrite:
        raise DataError(f"{output} exists; replace it with --overwrite, or give another name")
    in_run = (path / "result.npz").is_file()
    verdict: Verdict | None = None
    doubt: Array | None = None
    if flat:
        statistics = _of_flat(path, settings or [])
    elif in_run:
        if settings:
            raise ConfigError(f"{what}: a run that is finished takes no settings")
        statistics, verdict, doubt = _of_run(path)
    else:
        statistics, verdict, doubt = _of_burst(path, settings or [])
    for line in report_lines(statistics, verdict, doubt):
        typer.echo(line)
    picture = output or (path / "analysis.png" if in_run else Path("runs") / f"{path.stem}-analysis.png")
    picture.parent.mkdir(parents=True, exist_ok=True)
    write_analysis(picture, statistics, verdict, doubt)
    typer.echo(f"picture: {picture}")


def _of_flat(path: Path, settings: list[str]) -> Statistics:
    from deepir.analysis import flat_statistics
    from deepir.burst import load

    flat = load(recording_config(str(path), settings, ("data",)).data, needs=2)
    return flat_statistics(flat.frames, flat.valid.all(0) & ~flat.bad_pixels)


def _of_burst(path: Path, settings: list[str]) -> tuple[Statistics, Verdict | None, Array | None]:
    import deepir

    result = deepir.run("nuc", *settings, f"data.path={path}", output={})
    doubt = result.uncertainty.get("scene")
    return *_judged(result.gain, result.offset, result.scene, result.motion, result.bad_pixels), doubt


def _of_run(path: Path) -> tuple[Statistics, Verdict | None, Array | None]:
    import numpy as np

    with np.load(path / "result.npz") as stored:
        found = [stored[name] for name in ("gain", "offset", "scene", "motion", "bad_pixels")]
    beside, doubt = path / "uncertainty.npz", None
    if beside.exists():
        with np.load(beside) as stored:
            doubt = stored["scene"]
            doubt = doubt if doubt.ndim == 2 else None  # of a scene for each frame there is no one map
    return *_judged(*found), doubt


def _judged(
    gain: Array, offset: Array, scene: Array, motion: Array, bad: Array
) -> tuple[Statistics, Verdict | None]:
    """Of a result: the pattern that it would print on a scene as warm as the mean, and what motion makes of it."""
    import numpy as np

    from deepir.analysis import assess, map_statistics

    pattern = (gain - 1.0) * scene.mean(dtype=np.float64) + offset
    statistics = map_statistics(pattern, ~bad)
    finer = scene.shape[-2] / len(gain)  # px of the scene in one of the detector
    coarser = np.diag([1 / finer, 1 / finer, 1])
    seen = motion[np.isfinite(motion).all((1, 2))]
    if len(seen) < 2 or scene.ndim > 2:  # one frame, or a scene for each: nothing moves before the pattern
        return statistics, None
    return statistics, assess(statistics, coarser @ seen @ np.linalg.inv(coarser))
