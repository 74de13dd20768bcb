"""The commands `check` and `list`."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from deepir.cli.arguments import DATA_SETTINGS, Plugins, Settings, load_plugins
from deepir.cli.terminal import echo

if TYPE_CHECKING:
    from deepir.config import Config

STILL = "  motion: none"  # beginning of the line on frames in which no motion is seen
MOTION_FRAMES = 8  # frames that are registered where no motion is seen
MAX_FRAMES_OF_A_BURST = 30  # more are a recording
REFUSAL = "a run refuses it"  # beginning of the line on frames that a run does not accept


def list_components(
    name: Annotated[
        str | None,
        typer.Argument(metavar="NAME", help="A kind, such as fields, or a part of a name."),
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
    from deepir.errors import ConfigError, nearest

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
    from deepir.errors import ConfigError

    if what in shipped_names() or Path(what).suffix in (".yaml", ".yml"):
        _configuration(what, settings or [])
    elif Path(what).exists() or (not settings and ("*" in what or Path(what).suffix)):
        if wrong := next((each for each in settings or () if not each.startswith("data.")), None):
            raise ConfigError(f"{wrong}: settings go with a configuration: deepir check nuc data.path={what} {wrong}")
        lines = _burst(load("nuc", [f"data.path={what}", *(settings or ())]))
        for line in lines:
            echo(line)
        if lines[-1].startswith(REFUSAL):
            return 2
        if lines[1].startswith("  1 frame"):
            echo(
                f"one frame: its pattern is found from a burst of a moving camera; maps that are known correct it: "
                f"{shlex.join(['deepir', 'apply', 'MAPS', what])}"
            )
        else:
            command = ["deepir", "run", "nuc", f"data.path={what}", *(settings or ())]
            whole = all(each.startswith(DATA_SETTINGS) for each in settings or ())
            if whole and int(lines[1].split()[0]) > MAX_FRAMES_OF_A_BURST:
                command = ["deepir", "correct", what, *(settings or ())]
            still = lines[-1].startswith(STILL)
            echo(f"{'if it moved all the same' if still else 'to correct it'}: {shlex.join(command)}")
    else:
        return _configuration(what, settings or [])
    return 0


def _burst(config: Config) -> list[str]:
    import numpy as np

    from deepir.errors import DataError
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
    from deepir.errors import DataError
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
    from deepir.cli.commands.run import output_folder
    from deepir.config import load
    from deepir.pipeline.whole_recording import chosen
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
    if state == "new":
        echo(f"output folder: {folder.path} (new)")
    else:
        echo(f"output folder: {folder.path} already contains a run ({state}); use --overwrite")
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
