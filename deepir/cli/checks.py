"""Commands that look and do not correct: `list`, `check` and `analyze`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepir.cli.arguments import (
    DATA_SETTINGS,
    Overwrite,
    Plugins,
    Settings,
    held_outputs,
    load_plugins,
    recording_config,
)
from deepir.cli.runs import output_folder
from deepir.cli.terminal import echo, notify, watched_solve
from deepir.errors import ConfigError, DataError, nearest

if TYPE_CHECKING:
    from deepir.analysis import BurstAssessment, PatternStatistics
    from deepir.config import Config
    from deepir.result import Array

STILL = "  motion: none"  # beginning of the line on frames in which no motion is seen
MOTION_FRAMES = 8  # frames that are registered where no motion is seen
MAX_FRAMES_OF_A_BURST = 30  # more are a recording
REFUSAL = "a run refuses it"  # beginning of the line on frames that a run does not accept
JUDGED = ("gain", "offset", "scene", "motion", "bad_pixels")  # arrays of a result


def list_components(
    name: Annotated[
        str | None, typer.Argument(metavar="NAME", help="A kind, such as fields, or a part of a name.")
    ] = None,
    plugin: Plugins = None,
) -> None:
    """List what configurations may name: methods, operators, fields, penalties, priors, problems ..."""
    load_plugins(plugin)
    from deepir.config import SHIPPED_CONFIGS, headline, prior_names, shipped_names
    from deepir.registry import COMPONENT_MODULES, components, summary

    groups = {
        f"{kind}s".replace("ys", "ies"): {name: summary(each) for name, each in components(kind).items()}
        for kind in COMPONENT_MODULES
    }
    groups["priors (prior=NAME; a field or a .yaml file too)"] = {
        each: headline(SHIPPED_CONFIGS / "prior" / f"{each}.yaml") for each in prior_names()
    }
    groups["configs (deepir run NAME)"] = {each: headline(SHIPPED_CONFIGS / f"{each}.yaml") for each in shipped_names()}
    groups["effects"] = {
        each: f"{text} {_options(components('effect')[each])}".strip() for each, text in groups["effects"].items()
    }
    for title, entries in (groups if name is None else _matching(groups, name)).items():
        echo(f"{title}:")
        for each, text in entries.items():
            echo(f"  {each:<16} {text}")


def _matching(groups: Mapping[str, Mapping[str, str]], name: str) -> Mapping[str, Mapping[str, str]]:
    """The group of a kind, or the entries of all groups whose names hold `name`; `ConfigError` for none."""
    kinds = {title.partition(" ")[0]: title for title in groups}
    if (kind := next((each for each in kinds if each in (name, f"{name}s", f"{name[:-1]}ies")), None)) is not None:
        return {kinds[kind]: groups[kinds[kind]]}
    held = {title: {n: text for n, text in each.items() if name in n} for title, each in groups.items()}
    if found := {title: each for title, each in held.items() if each}:
        return found
    raise ConfigError(f"list: no kind and no component is called '{name}'; {nearest(name, kinds)}")


def _options(component: Any) -> str:
    """Options and their defaults in brackets; nothing without options."""
    from deepir.config.components import options_schema

    fields = options_schema(component).model_fields
    named = ", ".join(f"{name}={field.default}" for name, field in fields.items())
    return f"({named})" if named else ""


def check(
    what: Annotated[str, typer.Argument(metavar="FILE|CONFIG", help="A burst, or a configuration.")],
    settings: Settings = None,
    plugin: Plugins = None,
) -> int:
    """Describe a burst, or what a configuration would do, without a run: status 2 if a run refuses it."""
    load_plugins(plugin)
    from deepir.config import load, shipped_names

    given = settings or []
    is_config = what in shipped_names() or Path(what).suffix in (".yaml", ".yml")
    is_burst = Path(what).exists() or (not given and ("*" in what or Path(what).suffix))
    if is_config or not is_burst:
        return _configuration(what, given)
    if wrong := next((each for each in given if not each.startswith("data.")), None):
        raise ConfigError(f"{wrong}: settings go with a configuration: deepir check nuc data.path={what} {wrong}")
    lines = _burst(load("nuc", [f"data.path={what}", *given]))
    for line in lines:
        echo(line)
    if lines[-1].startswith(REFUSAL):
        return 2
    if lines[1].startswith("  1 frame"):
        echo(
            f"one frame: its pattern is found from a burst of a moving camera; maps that are known correct it: "
            f"{shlex.join(['deepir', 'apply', 'MAPS', what])}"
        )
        return 0
    command = ["deepir", "run", "nuc", f"data.path={what}", *given]
    if all(each.startswith(DATA_SETTINGS) for each in given) and int(lines[1].split()[0]) > MAX_FRAMES_OF_A_BURST:
        command = ["deepir", "correct", what, *given]
    still = lines[-1].startswith(STILL)
    echo(f"{'if it moved all the same' if still else 'to correct it'}: {shlex.join(command)}")
    return 2 if still else 0


def _burst(config: Config) -> list[str]:
    import numpy as np

    from deepir.io import crop, describe, read_data, validate
    from deepir.io.inspection.checks import unusable_frames
    from deepir.io.radiometry import resolve_radiometry

    data = config.data
    frames = read_data(data)
    if data.crop is not None:
        frames = replace(frames, frames=crop(frames.frames, data.crop))
    kelvin = resolve_radiometry(frames.radiometry, data.radiometry)
    lines = describe(replace(frames, radiometry=kelvin))
    lines = [f"data: {frames.source}", *(f"  {line}" for line in lines)]
    try:
        unusable = [*unusable_frames(frames.frames)]
        validate(np.delete(frames.frames, unusable, axis=0) if unusable else frames.frames, frames.source)
    except DataError as error:
        lines.append(f"{REFUSAL}: {error}")
        return lines
    if lines[-1].startswith(STILL) and (step := _registered_step(config)):
        lines[-1] = f"  motion: yes, {step:.1f} px between frames, as a run registers them"
    return lines


def _registered_step(config: Config) -> float:
    """Motion between consecutive frames, px, median, as a run finds it; zero where it finds none."""
    import numpy as np

    from deepir.burst import load
    from deepir.pipeline.register import register_frames
    from deepir.pipeline.schedule import make_recipe

    burst = load(config.data, needs=2)
    some = np.unique(np.linspace(0, len(burst.frames) - 1, MOTION_FRAMES).astype(int))
    burst = replace(burst, frames=burst.frames[some], valid=burst.valid[some])
    try:
        motion, used, _ = register_frames(burst, config, make_recipe(config))
    except DataError:
        return 0.0
    at = np.empty(0) if motion is None else motion.numpy()[used][:, :2, 2]
    return float(np.median(np.hypot(*np.diff(at, axis=0).T))) if len(at) > 1 else 0.0


def _configuration(name: str, settings: list[str]) -> int:
    from deepir.config import load
    from deepir.pipeline.reconstruct import chosen
    from deepir.storage.folder import RunFolder

    config = load(name, settings)
    folder = RunFolder(output_folder(config, name))
    state = folder.state()
    data = _data(config)
    echo(f"configuration {name} is valid; problem {config.problem}, method {chosen(config)[0]}")
    for stage, slots in config.physics.items():
        echo(f"  {stage}: {_short(slots) or 'no options'}")
    for each, given in config.datasets.items():
        echo(f"  data set {each}: {given.data.path or 'no data yet'}, scene {given.scene}")
    echo(f"  scene: prior {config.prior}, {_short(config.scene)}")
    for line in data:
        echo(line)
    there = f"already contains a run ({state}); use --overwrite"
    echo(f"output folder: {folder.path} {'(new)' if state == 'new' else there}")
    return 2 if data[-1].startswith(REFUSAL) else 0


def _data(config: Config) -> list[str]:
    """Describe the data in lines; check the components against them, or against zeros if there are none."""
    import numpy as np

    from deepir.burst import Burst
    from deepir.runner import check_components, prepare

    if config.data.simulate is not None:
        burst = prepare(config)
        return [f"data: {burst.source}, {len(burst.frames)} frames of {burst.size[0]} x {burst.size[1]} px"]
    if config.data.path is not None:
        prepare(config)
        return _burst(config)
    frames = np.zeros((2, 64, 80), np.float32)
    check_components(config, Burst(frames, np.ones(frames.shape, bool), np.zeros(frames.shape[1:], bool)))
    return ["data: none given (data.path=burst.npz)"]


def _short(settings: Any) -> str:
    """A mapping in one line."""
    if isinstance(settings, dict):
        return ", ".join(f"{key} {_short(value)}" if key != "type" else str(value) for key, value in settings.items())
    return str(settings)


def analyze(
    what: Annotated[str, typer.Argument(metavar="FILE|RUN", help="A burst, or the folder of a run.")],
    settings: Settings = None,
    flat: Annotated[bool, typer.Option("--flat", help="The frames are of a uniform source.")] = False,
    output: Annotated[
        Path | None, typer.Option(help="File of the picture; default: NAME_analysis.png, or NAME_flat.png.")
    ] = None,
    overwrite: Overwrite = False,
) -> None:
    """Report the jitter and the frames that a camera needs: deepir analyze burst.npz, or shutter.npz --flat.

    A burst is solved first, with the settings of `deepir run nuc`, and rated. With --flat, settings are those of the
    file's format.
    """
    from deepir.analysis import report_lines
    from deepir.paths import expanded
    from deepir.report.panels import write_analysis

    path = expanded(what)
    given, is_run = settings or [], (path / "result.npz").is_file()
    if is_run and given and not flat:
        raise ConfigError(f"{path}: a finished run takes no settings")
    own = path / "analysis.png" if is_run else Path(f"{path.stem}_{'flat' if flat else 'analysis'}.png")
    picture, assessment, scene_deviation = output or own, None, None
    with held_outputs(picture, overwrite=overwrite, suffix=".png"):
        if flat:
            statistics = _of_flat(path, given)
        else:
            arrays, scene_deviation = _of_run(path) if is_run else _of_burst(path, given)
            statistics, assessment = _judged(**arrays)
        for line in report_lines(statistics, assessment, scene_deviation):
            echo(line)
        write_analysis(picture, statistics, assessment, scene_deviation)
    echo(f"picture: {picture}")


def _of_flat(path: Path, settings: list[str]) -> PatternStatistics:
    from deepir.analysis import flat_statistics
    from deepir.burst import load

    flat = load(recording_config(str(path), settings, ("data",)).data, needs=2)
    return flat_statistics(flat.frames, flat.valid.all(0) & ~flat.bad_pixels)


def _of_burst(path: Path, settings: list[str]) -> tuple[dict[str, Array], Array | None]:
    """Arrays of the result of a burst, and the deviation of its scene."""
    import deepir
    from deepir.messages import labelled, shown

    with watched_solve() as callbacks:
        result = deepir.run("nuc", *settings, f"data.path={path}", output={}, callbacks=callbacks)
    for line in shown(labelled(result.messages), f"the report of `deepir run nuc data.path={path}`"):
        notify(line)
    return {name: getattr(result, name) for name in JUDGED}, result.uncertainty.get("scene")


def _of_run(path: Path) -> tuple[dict[str, Array], Array | None]:
    """The same of a run in a folder."""
    import numpy as np

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
