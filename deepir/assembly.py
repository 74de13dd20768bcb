"""Build a problem from a configuration: its data sets, unknowns and operator."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from functools import partial
from typing import Any

import torch
from torch import Tensor

from deepir.burst import Burst
from deepir.config import Config
from deepir.config.components import make, options_schema
from deepir.errors import ConfigError, nearest
from deepir.fields.base import Field
from deepir.fields.constant import Constant, read_map
from deepir.fields.sensor_maps import SumField
from deepir.likelihoods import Fidelity
from deepir.operators import Chain, Operator, Warp
from deepir.operators.base import Trajectory
from deepir.operators.motion_models import Canvas, Geometry, locate_first_frame
from deepir.operators.warp import footprint, rescale_motion
from deepir.priors.penalties.base import Penalty
from deepir.problem import Problem
from deepir.registry import lookup

#: What a slot's configuration may hold beside its field's own options.
SLOT_KEYS = ("type", "init", "fixed", "penalties", "fit", "unknown")


def complete(given: Any, neutral: float | None, where: str) -> dict[str, Any]:
    """A slot's configuration in full: a name stands for a type, a number for a constant, nothing for neutral."""
    if given is None:
        if neutral is None:
            raise ConfigError(f"{where}: missing; say what it is, for example {where}.type=constant")
        return {"type": "constant"}
    if isinstance(given, bool) or not isinstance(given, str | int | float | Mapping):
        raise ConfigError(f"{where} = {given!r}: give a type, a number, or a mapping with 'type'")
    if isinstance(given, str):
        return {"type": given}
    if isinstance(given, int | float):
        return {"type": "constant", "value": float(given)}
    if "type" not in given:
        raise ConfigError(f"{where}: 'type' is missing; `deepir list` shows the fields there are")
    return dict(given)


def make_field(
    settings: Mapping[str, Any],
    shape: tuple[int, ...],
    neutral: float,
    size: Any,
    ratio: float,
    where: str,
    fits: Callable[[tuple[int, ...]], bool],
    *,
    anchored: bool = True,
) -> Field:
    """The field that a slot's complete `settings` name; a sum where they name several, `column+pixel`.

    A motion is `anchored` if frame 0 defines where the scene is.
    """
    options = {k: v for k, v in settings.items() if k not in SLOT_KEYS}
    kind = str(settings["type"])
    context = {"shape": shape, "neutral": neutral, "size": size, "ratio": ratio, "anchored": anchored}
    if "+" not in kind:
        field = _fitting(kind, options, where, context, fits)
    else:
        members = [name.strip() for name in kind.split("+")]
        if unknown := sorted(set(options) - set(members)):
            raise ConfigError(f"{where}: no option '{unknown[0]}'; {nearest(unknown[0], members)}")
        field = SumField(shape, neutral, {
            name: _fitting(name, options.get(name) or {}, f"{where}.{name}", {**context, "neutral": 0.0}, fits)
            for name in members
        })  # fmt: skip
    if not isinstance(fixed := settings.get("fixed", False), bool):
        raise ConfigError(f"{where}.fixed = {fixed!r}: true or false is needed")
    if fixed:
        field.requires_grad_(False)
    return field


def shared_field(name: str, known: Mapping[str, Field], where: str, fits: Callable[[tuple[int, ...]], bool]) -> Field:
    """The field of an unknown of another data set; `ConfigError` if there is none, or none that fits."""
    if name not in known:
        raise ConfigError(f"{where}.unknown: no unknown '{name}' in the data sets before; {nearest(name, known)}")
    if not fits(tuple(known[name].shape)):
        raise ConfigError(f"{where}.unknown: '{name}' is {known[name].shape}, which does not fit here")
    return known[name]


@torch.no_grad()
def _fitting(
    kind: str,
    options: Mapping[str, Any],
    where: str,
    context: Mapping[str, Any],
    fits: Callable[[tuple[int, ...]], bool],
) -> Field:
    """A field whose value has the shape that its slot wants."""
    field: Field = make("field", kind, options, where, **context)
    try:
        found = tuple(field().shape)
    except (RuntimeError, IndexError):  # it cannot even be expanded to the shape
        found = None
    if found is None or not fits(found):
        made = f", not {found}" if found else ""
        raise ConfigError(f"{where}: the field '{kind}' does not fit: {context['shape']} is wanted{made}")
    return field


def make_penalties(settings: Mapping[str, Any], where: str, shape: tuple[int, ...]) -> dict[str, Penalty]:
    """The penalties under `penalties`, by name; those that are null are left out."""
    found, wanted = {}, settings.get("penalties") or {}
    if not isinstance(wanted, Mapping):
        raise ConfigError(f"{where}.penalties = {wanted!r}: a mapping is needed, for example {where}.penalties.tv=50")
    for name, given in wanted.items():
        if given is None:  # what a preset has, left out
            continue
        options = {"weight": given} if isinstance(given, int | float | str) else given
        found[name] = make("penalty", name, options, f"{where}.penalties.{name}", shape=shape)
    return found


@torch.no_grad()
def demand_sense(slot: str, field: Field, where: str, *, anchored: bool = True) -> None:
    """Raise `ConfigError` for a start that docs/reference/conventions.md rules out."""
    value = field()
    if slot == "gain" and not value.mean() > 0:
        raise ConfigError(f"{where}: a gain has a positive mean, not {float(value.mean()):g}")
    if slot == "tau" and not value.min() > (0 if list(field.parameters()) else -1e-9):
        raise ConfigError(
            f"{where}: a time constant, in ms, is not negative, and one that is to be found starts above zero: "
            f"{where}.init=10"
        )
    matrices = anchored and slot == "motion" and value.shape[1:] == (3, 3)
    if matrices and not torch.allclose(value[0], torch.eye(3).to(value), atol=1e-4):
        raise ConfigError(f"{where}: the first frame's motion is the identity, not {value[0].tolist()}")


def start_field(
    field: Field, settings: Mapping[str, Any], motion: Tensor | None, geometry: Geometry, where: str
) -> None:
    """Put a slot's field at its `init`: a number, an array's file, or the registered motion."""
    init = settings.get("init", "register" if field.model else None)
    if isinstance(field, Constant) and init is not None:
        raise ConfigError(f"{where}.init: what is known is given by {where}.value or {where}.path")
    try:
        _start(field, init, motion, geometry, where)
    except (RuntimeError, IndexError) as error:  # of another shape, or numbers that it cannot be
        raise ConfigError(f"{where}.init = {init!r}: the field cannot start there") from error


def _start(field: Field, init: Any, motion: Tensor | None, geometry: Geometry, where: str) -> None:
    if init == "register":
        if motion is not None:
            field.init_from(rescale_motion(motion, geometry.ratio))
    elif isinstance(init, int | float) and not isinstance(init, bool):
        field.init_from(torch.full(field.shape, float(init)))
    elif isinstance(init, str):
        value = read_map(init).squeeze()
        alike = list(value.shape) == [side for side in field.shape if side > 1]
        value = value.reshape(field.shape) if alike else value
        try:
            field.init_from(value)
        except RuntimeError as error:
            raise ConfigError(
                f"{where}.init: {init} has shape {tuple(value.shape)}, {field.shape} is wanted"
            ) from error
    elif init is not None:
        raise ConfigError(f"{where}.init = {init!r}: a number, 'register' (a motion), or an array's file is needed")


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
    shared = config.scene.get("shared", True)
    if not isinstance(shared, bool):
        raise ConfigError(f"scene.shared = {shared!r}: true or false is needed")
    scene_shape = (1 if shared else n_frames, 1, *operator.in_size(burst.size))
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
        place = (settings, shape, neutral or 0.0, size, math.prod(geometry.ratio) ** 0.5, where, fits)
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
        if problem.sensor is not None and (level := problem.sensor.reference) is not None:
            low, high = min(0.0, float(data.min())), max(0.0, float(data.max()))
            if not low - (high - low) <= level <= high + (high - low):
                raise ConfigError(
                    f"physics.{operator.named()[-1][0]}.reference = {level:g}: the data are {float(data.min()):g} to "
                    f"{float(data.max()):g}; give a level in their units, 0 for a raw detector, or auto"
                )
            problem.measure_from(level)
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
        ratio = [(far - near) / side for far, near, side in zip(twice, out, size, strict=True)]
        if shared is None:
            seen = known_motion(slots[name], where) if motion is None else instants.interpolate(motion)
            canvas, origin = footprint(seen, out, ratio)
        else:
            canvas, origin = shared.size, shared.origin(out)
        place = {"size": out, "canvas": canvas, "origin": origin}
        stage = make("operator", kind, options, where, **place, instants=instants, fps=config.data.fps)
        stages[name] = stage
        instants = stage.trajectory if stage.trajectory != Trajectory() else instants
        try:
            out, twice = stage.in_size(out), (stage.in_size(twice) if not isinstance(stage, Warp) else twice)
        except ValueError as error:
            raise ConfigError(f"{where}: {error}") from error
    chain = Chain(dict(reversed(stages.items())))
    shapes = chain.slots((1, 1, *out), n_frames)
    for name, own in slots.items():
        allowed = [slot.rpartition(".")[2] for slot in shapes if slot.startswith(f"{name}.")]
        for key in own:
            if key not in allowed:
                component: Any = type(chain.stages[name])
                options_of = options_schema(component).model_fields
                raise ConfigError(f"physics.{name}: no '{key}'; {nearest(key, [*allowed, *options_of, 'type'])}")
    return chain, slots, locate_first_frame(chain, size, out)


def known_motion(slots: Mapping[str, Any], where: str) -> Tensor | None:
    """The motion that a stage's slots take from a file; None if it is not known."""
    given = slots.get("motion")
    if not isinstance(given, Mapping) or given.get("type") != "constant" or given.get("path") is None:
        return None
    found = read_map(str(given["path"]), given.get("key"))
    if found.ndim not in (3, 4) or (found.ndim == 3 and found.shape[1:] != (3, 3)):
        raise ConfigError(
            f"{where}.motion: {given['path']}: (N, 3, 3) or (N, h, w, 2) is wanted, not {tuple(found.shape)}"
        )
    return found


def _unknowns(slots: list[str]) -> dict[str, str]:
    """Slot -> unknown: the slot's own name (a mere `value` has its stage's), with its stage where two would clash."""
    own = [slot.removesuffix(".value").rpartition(".")[2] for slot in slots]
    return {
        slot: name if own.count(name) == 1 and name != "scene" else slot.replace(".", "_")
        for slot, name in zip(slots, own, strict=True)
    }


FIRST = ""  # the name of the data set that `data` and `physics` describe


def data_sets(config: Config, burst: Burst) -> Iterator[tuple[str, Config, Burst]]:
    """Name, configuration and frames of each data set, the first one's first."""
    yield FIRST, config, burst
    for name, given in config.datasets.items():
        physics = config.physics if given.physics is None else given.physics
        own = {"physics": physics, "data": given.data, "noise": given.noise}
        yield name, config.model_copy(update=own), burst.datasets[name]


def build_data_sets(
    config: Config, burst: Burst, motions: Mapping[str, Tensor | None]
) -> tuple[dict[str, Problem], dict[str, Geometry]]:
    """The data sets that `config.datasets` describes, their fields at their starts.

    Args:
        config: Already checked by `deepir.config.load`.
        burst: The frames that are used, with those of the other data sets.
        motions: (N, 3, 3) of each data set, as `deepir.assembly.build` takes it.

    Returns:
        The data sets by name, and where the frame 0 of each lies in its scene.

    Raises:
        ConfigError: See `deepir.assembly.build`; or a data set names an unknown that there is not.
    """
    sharing = [FIRST, *(name for name, given in config.datasets.items() if given.scene == "shared")]
    sets = list(data_sets(config, burst))
    warps = []
    for name, own, frames in sets:
        if name in sharing:
            operator, _, _ = make_operator(own, frames.size, len(frames.frames), motions[name])
            warps += [stage for _, stage in operator.named()[:1] if isinstance(stage, Warp)]
    canvas = Canvas.around(warps) if len(warps) > 1 else None
    problems: dict[str, Problem] = {}
    places: dict[str, Geometry] = {}
    known: dict[str, Field] = {}
    for name, own, frames in sets:
        shared = name in sharing
        given = known if shared else {key: field for key, field in known.items() if key != "scene"}
        place = canvas if shared else None
        try:
            problems[name], places[name] = build(own, frames, motions[name], known=given, canvas=place)
        except ConfigError as error:
            if name == FIRST:
                raise
            raise ConfigError(f"datasets.{name}: {error}") from error
        prefix = f"{name}_" if name else ""
        known = {prefix + key: field for key, field in problems[name].fields.items()} | known
    return problems, places
