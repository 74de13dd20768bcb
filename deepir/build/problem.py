"""From a configuration and a burst to a problem."""

from __future__ import annotations

from collections.abc import Mapping
from functools import partial
from typing import Any

import torch
from torch import Tensor

from deepir.build.unknowns import (
    complete,
    demand_sense,
    make_field,
    make_penalties,
    shared_field,
    start_field,
)
from deepir.burst import Burst
from deepir.config import Config
from deepir.config.components import make, options_schema
from deepir.errors import ConfigError, nearest
from deepir.fields.base import Field
from deepir.likelihoods import Fidelity
from deepir.operators import Chain, Operator, Sensor, Warp
from deepir.operators.base import Trajectory
from deepir.operators.motion_models import Canvas, Geometry, footprint, locate_first_frame
from deepir.priors.penalties.base import Penalty
from deepir.problem import Problem
from deepir.registry import lookup

#: The scene that finds the sensor for a prior that is fitted after it.
PIXELS_WITH_TV = {"type": "pixels", "penalties": {"tv": "auto"}}
#: The stages of `physics: {}`: the frames show the scene as it is.
NO_PHYSICS: dict[str, dict[str, Any] | None] = {"identity": None}


def build(
    config: Config,
    burst: Burst,
    motion: Tensor | None = None,
    *,
    known: Mapping[str, Field] | None = None,
    canvas: Canvas | None = None,
) -> tuple[Problem, Geometry]:
    """The problem that `config` describes, its fields at their starts.

    Args:
        config: Already checked by `deepir.config.load`.
        burst: The frames that are used.
        motion: (N, 3, 3) float64, registered pull homographies in detector px; None: no motion.
        known: Unknowns of other data sets, by which slots may be called; with a `scene`, that is the scene, too.
        canvas: Of a scene that other data sets show, too.

    Raises:
        ConfigError: A component, option or slot is unknown or does not fit; the message gives its path.
    """
    n_frames = len(burst.frames)
    operator, slots, geometry = make_operator(config, burst.size, n_frames, motion, canvas)
    known, anchored = known or {}, "scene" not in (known or {})
    scene_shape = (_scenes(config, n_frames), 1, *operator.in_size(burst.size))
    shapes = operator.slots(scene_shape, n_frames)
    names = _unknowns(list(shapes))
    fields: dict[str, Field] = {}
    penalties: dict[str, dict[str, Penalty]] = {}
    for slot, shape in shapes.items():
        stage, _, own = slot.rpartition(".")
        neutral = operator.stages[stage].neutral.get(own)  # type: ignore[union-attr, operator]
        where = f"physics.{slot}"
        if own in ("gain", "offset") and shape[-2:] != burst.size:
            raise ConfigError(
                f"{where}: it belongs to the detector, {burst.size[0]} x {burst.size[1]} px; "
                f"stages that change the size go before '{stage}'"
            )
        fits = partial(dict(operator.named())[stage].fits, own, shape)
        given = slots[stage].get(own)
        if isinstance(given, Mapping) and "unknown" in given:
            fields[names[slot]] = shared_field(str(given["unknown"]), known, where, fits)
            continue
        settings = complete(given, neutral, where)
        size = getattr(operator.stages[stage], "size", burst.size)
        place = (settings, shape, neutral or 0.0, size, geometry.ratio, where, fits)
        fields[names[slot]] = make_field(*place, anchored=anchored)
        penalties[names[slot]] = make_penalties(settings, where, shape)
        start_field(fields[names[slot]], settings, motion, geometry, where)
        demand_sense(own, fields[names[slot]], where, anchored=anchored)
    scene = PIXELS_WITH_TV if config.scene.get("fit") else config.scene
    if anchored:
        fields["scene"], penalties["scene"] = build_scene(scene, scene_shape)
    elif known["scene"].shape == scene_shape:
        fields["scene"] = known["scene"]
    else:
        raise ConfigError(
            f"physics: the scene that is shared has {known['scene'].shape[-2:]} px, and these stages want "
            f"{scene_shape[-2:]}: begin with a stage 'warp' in each of the data sets, or give scene: own"
        )

    data = torch.from_numpy(burst.frames)[:, None]
    usable = torch.from_numpy(burst.valid & ~burst.bad_pixels)[:, None]
    bounded = burst.clipped is not None and config.effects.get("saturation") is not False
    problem = Problem(
        operator,
        fields,
        data,
        usable.to(data),
        slots=names,
        penalties={name: each for name, each in penalties.items() if each},
        fidelity=_fidelity(config, data, usable),
        saturation=torch.from_numpy(burst.clipped)[:, None] if bounded else None,
        agc=burst.stretched,
    )
    with torch.no_grad():
        problem.precision *= problem.valid(problem.values())
        name, last = operator.named()[-1]
        if isinstance(last, Sensor) and last.reference is not None:
            _demand_near(last.reference, data, f"physics.{name}.reference")
            problem.measure_from(last.reference)
    return problem, geometry


def _fidelity(config: Config, data: Tensor, usable: Tensor) -> Fidelity:
    """How prediction and data are compared."""
    given = config.fidelity if isinstance(config.fidelity, dict) else {"type": config.fidelity}
    options = {k: v for k, v in given.items() if k != "type"}
    found: Fidelity = make("fidelity", str(given.get("type", "gaussian")), options, "fidelity")
    try:
        found.check_data(data, usable)
    except ValueError as error:
        raise ConfigError(f"fidelity: {error}") from error
    return found


def _demand_near(level: float, data: Tensor, where: str) -> None:
    """Raise `ConfigError` for a level that is further from the data than zero is, by more than they span."""
    low, high = min(0.0, float(data.min())), max(0.0, float(data.max()))
    if not low - (high - low) <= level <= high + (high - low):
        raise ConfigError(
            f"{where} = {level:g}: the data are {float(data.min()):g} to {float(data.max()):g}; give a level in their "
            "units, 0 for a raw detector, or auto"
        )


def build_scene(
    given: Mapping[str, Any], shape: tuple[int, ...], device: torch.device | None = None
) -> tuple[Field, dict[str, Penalty]]:
    """The scene's field and its penalties, from the configuration's `scene`."""
    settings = complete({key: value for key, value in given.items() if key != "shared"}, None, "scene")
    allowed = ("average", "tv") if settings.get("fit") else ("average",)
    if settings.get("init", "average") not in allowed:
        raise ConfigError(
            f"scene.init = {settings['init']!r}: a scene starts at the registered 'average', or, with a 'fit' of its "
            "own, at the result of 'tv'"
        )
    field = make_field(settings, shape, 0.0, shape[-2:], 1.0, "scene", shape.__eq__).to(device)
    penalties = make_penalties(settings, "scene", shape)
    return field, {name: penalty.to(device) for name, penalty in penalties.items()}


def _scenes(config: Config, n_frames: int) -> int:
    """How many scenes there are: one, or with `scene.shared: false` one for each frame."""
    shared = config.scene.get("shared", True)
    if not isinstance(shared, bool):
        raise ConfigError(f"scene.shared = {shared!r}: true or false is needed")
    return 1 if shared else n_frames


def make_operator(
    config: Config, size: tuple[int, int], n_frames: int, motion: Tensor | None, shared: Canvas | None = None
) -> tuple[Chain, dict[str, dict[str, Any]], Geometry]:
    """The chain, the slots' configurations by stage, and the geometry; sizes are found from the data backwards."""
    stages: dict[str, Operator] = {}
    slots: dict[str, dict[str, Any]] = {}
    out, twice = size, (2 * size[0], 2 * size[1])
    instants, origin = Trajectory(), (0.0, 0.0)
    for name, settings in reversed((config.physics or NO_PHYSICS).items()):
        where = f"physics.{name}"
        if "." in name:
            raise ConfigError(f"{where}: a stage's name has no dot")
        kind = str((settings or {}).get("type", name))
        known = options_schema(lookup("operator", kind, where)).model_fields
        options = {k: v for k, v in (settings or {}).items() if k in known}
        slots[name] = {k: v for k, v in (settings or {}).items() if k not in known and k != "type"}
        ratio = (twice[0] - out[0]) / size[0]
        if shared is None:
            canvas, origin = footprint(None if motion is None else instants.interpolate(motion), out, ratio)
        else:
            canvas, origin = shared.size, shared.origin(out)
        place = {"size": out, "canvas": canvas, "origin": origin}
        stage = make("operator", kind, options, where, **place, instants=instants, fps=config.data.fps)
        stages[name] = stage
        instants = stage.trajectory if stage.trajectory != Trajectory() else instants
        out, twice = stage.in_size(out), (stage.in_size(twice) if not isinstance(stage, Warp) else twice)
    chain = Chain(dict(reversed(stages.items())))
    shapes = chain.slots((1, 1, *out), n_frames)
    for name, own in slots.items():
        allowed = [slot.rpartition(".")[2] for slot in shapes if slot.startswith(f"{name}.")]
        for key in own:
            if key not in allowed:
                component: Any = type(chain.stages[name])
                options_of = options_schema(component).model_fields
                raise ConfigError(
                    f"physics.{name}: no '{key}'; {nearest(key, [*allowed, *options_of, 'type'])}"
                )
    return chain, slots, locate_first_frame(chain, size, out)


def _unknowns(slots: list[str]) -> dict[str, str]:
    """Slot -> unknown: the slot's own name (a mere `value` has its stage's), with its stage where two would clash."""
    own = [slot.removesuffix(".value").rpartition(".")[2] for slot in slots]
    return {
        slot: name if own.count(name) == 1 and name != "scene" else slot.replace(".", "_")
        for slot, name in zip(slots, own, strict=True)
    }
