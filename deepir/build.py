"""From a configuration and a burst to a problem."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np
import torch
from scipy.fft import next_fast_len
from torch import Tensor

from deepir.burst import Burst
from deepir.components import make, options_schema
from deepir.config import Config
from deepir.errors import ConfigError, nearest
from deepir.operators import Chain, Operator, Warp
from deepir.operators.path import Path
from deepir.operators.warp import NEAR
from deepir.penalties.penalty import Penalty
from deepir.priors.field import Field
from deepir.priors.parts import Sum
from deepir.problem import Problem
from deepir.registry import lookup

MARGIN = 8  # px that the canvas reaches beyond the registered footprints
#: What a slot's configuration may hold beside its field's own options.
SLOT_KEYS = ("type", "init", "fixed", "penalties", "fit")
#: The scene that finds the sensor for a prior that is fitted after it.
FREE = {"type": "pixels", "penalties": {"tv": "auto"}}


@dataclass(frozen=True)
class Geometry:
    """Sizes along the operator, and where frame 0 lies in the scene."""

    ratio: float  # scene px per detector px
    window: tuple[int, int, int, int]  # (y0, y1, x0, x1) of frame 0 in the scene's array

    def crop(self, scene: Any) -> Any:
        """The part of a scene (1, 1, H, W) that frame 0 shows, (h, w); of one for each frame, (N, h, w)."""
        y0, y1, x0, x1 = self.window
        pictures = scene[:, 0, y0:y1, x0:x1]
        return pictures[0] if len(pictures) == 1 else pictures


def build(config: Config, burst: Burst, motion: Tensor | None = None) -> tuple[Problem, Geometry]:
    """The problem that `config` describes, its fields at their starts.

    Args:
        config: Already checked by `deepir.config.load`.
        burst: The frames that are used.
        motion: (N, 3, 3) float64, registered pull homographies in detector px; None: no motion.

    Raises:
        ConfigError: A component, option or slot is unknown or does not fit; the message gives its path.
    """
    n_frames = len(burst.frames)
    operator, slots, geometry = _operator(config, burst.size, n_frames, motion)
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
        settings = _slot_settings(slots[stage].get(own), neutral, where)
        size = getattr(operator.stages[stage], "size", burst.size)
        fits = partial(dict(operator.named())[stage].fits, own, shape)
        fields[names[slot]] = _field(settings, shape, neutral or 0.0, size, geometry.ratio, where, fits)
        penalties[names[slot]] = _penalties(settings, where, shape)
        _start(fields[names[slot]], settings, motion, geometry, where)
        _demand_sense(own, fields[names[slot]], where)
    scene = FREE if config.scene.get("fit") else config.scene
    fields["scene"], penalties["scene"] = build_scene(scene, scene_shape)

    data = torch.from_numpy(burst.frames)[:, None]
    usable = torch.from_numpy(burst.valid & ~burst.bad_pixels)[:, None]
    fidelity = config.fidelity if isinstance(config.fidelity, dict) else {"type": config.fidelity}
    kind = str(fidelity.get("type", "gaussian"))
    options = {k: v for k, v in fidelity.items() if k != "type"}
    problem = Problem(
        operator,
        fields,
        data,
        usable.to(data),
        slots=names,
        penalties={name: each for name, each in penalties.items() if each},
        fidelity=make("fidelity", kind, options, "fidelity"),
    )
    with torch.no_grad():
        problem.precision *= problem.valid(problem.values())
    return problem, geometry


def build_scene(given: Mapping[str, Any], shape: tuple[int, ...]) -> tuple[Field, dict[str, Penalty]]:
    """The scene's field and its penalties, from the configuration's `scene`."""
    settings = _slot_settings({key: value for key, value in given.items() if key != "shared"}, None, "scene")
    allowed = ("average", "tv") if settings.get("fit") else ("average",)
    if settings.get("init", "average") not in allowed:
        raise ConfigError(
            f"scene.init = {settings['init']!r}: a scene starts at the registered 'average', or, with a 'fit' of its "
            "own, at the result of 'tv'"
        )
    field = _field(settings, shape, 0.0, shape[-2:], 1.0, "scene", shape.__eq__)
    return field, _penalties(settings, "scene", shape)


def _scenes(config: Config, n_frames: int) -> int:
    """How many scenes there are: one, or with `scene.shared: false` one for each frame."""
    shared = config.scene.get("shared", True)
    if not isinstance(shared, bool):
        raise ConfigError(f"scene.shared = {shared!r}: true or false is needed")
    return 1 if shared else n_frames


def _operator(
    config: Config, size: tuple[int, int], n_frames: int, motion: Tensor | None
) -> tuple[Chain, dict[str, dict[str, Any]], Geometry]:
    """The chain, the slots' configurations by stage, and the geometry; sizes are found from the data backwards."""
    if not config.physics:
        raise ConfigError("physics: at least one stage is needed")
    stages: dict[str, Operator] = {}
    slots: dict[str, dict[str, Any]] = {}
    out, twice = size, (2 * size[0], 2 * size[1])
    origin, instants = (0, 0), Path()
    for name, settings in reversed(config.physics.items()):
        where = f"physics.{name}"
        if "." in name:
            raise ConfigError(f"{where}: a stage's name has no dot")
        kind = str((settings or {}).get("type", name))
        known = options_schema(lookup("operator", kind, where)).model_fields
        options = {k: v for k, v in (settings or {}).items() if k in known}
        slots[name] = {k: v for k, v in (settings or {}).items() if k not in known and k != "type"}
        ratio = (twice[0] - out[0]) / size[0]
        canvas, origin = _canvas(None if motion is None else instants.through(motion), out, ratio)
        place = {"size": out, "canvas": canvas, "origin": origin}
        stage = make("operator", kind, options, where, **place, instants=instants, fps=config.data.fps)
        stages[name] = stage
        instants = stage.path if stage.path != Path() else instants
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
    return chain, slots, _geometry(chain, size, out)


def _geometry(chain: Chain, size: tuple[int, int], scene: tuple[int, int]) -> Geometry:
    """Frame 0's window has the frame's size times the ratio, and its centre."""
    stages = [stage for _, stage in chain.named()]
    first, later = stages[0], Chain(dict(chain.named()[1:]))
    rest = later if isinstance(first, Warp) else chain
    near, far = rest.in_size(size), rest.in_size((2 * size[0], 2 * size[1]))
    ratio = (far[0] - near[0]) / size[0]
    height, width = round(ratio * size[0]), round(ratio * size[1])
    y0, x0 = first.origin if isinstance(first, Warp) else (0, 0)
    inner = near if isinstance(first, Warp) else scene
    y0, x0 = y0 + (inner[0] - height) // 2, x0 + (inner[1] - width) // 2
    return Geometry(ratio, (int(y0), int(y0) + height, int(x0), int(x0) + width))


def _canvas(
    motion: Tensor | None, size: tuple[int, int], ratio: float
) -> tuple[tuple[int, int], tuple[int, int]]:
    """Canvas (H, W) and origin (y, x) that hold all footprints of frames of `size`, and a margin."""
    if motion is None:
        motion = torch.eye(3, dtype=torch.float64)[None]
    y, x = ((side - 1) / 2 for side in size)
    corners = torch.tensor([[-x, x, -x, x], [-y, -y, y, y], [1, 1, 1, 1]], dtype=torch.float64)
    moved = scaled(motion, ratio).double() @ corners
    points = moved[:, :2] / moved[:, 2:].clamp(min=NEAR) + corners.new_tensor([[x], [y]])
    low, high = points.amin((0, 2)), points.amax((0, 2))  # straight lines stay straight
    x0, y0 = (MARGIN + math.ceil(max(0.0, -float(v))) for v in low)
    x1, y1 = (
        MARGIN + math.ceil(max(float(v), side - 1)) for v, side in zip(high, reversed(size), strict=True)
    )
    return (_quick(y0 + y1 + 1), _quick(x0 + x1 + 1)), (y0, x0)


def _quick(side: int) -> int:
    """An even length, a little more than `side`, whose Fourier transform is two or three times as fast."""
    return 2 * int(next_fast_len(-(-side // 2)))


def scaled(motion: Tensor, ratio: float) -> Tensor:
    """A motion in px of a grid that is `ratio` times finer; the centres coincide."""
    s = torch.tensor([ratio, ratio, 1.0], dtype=motion.dtype)
    return motion * (s[:, None] / s)


def _unknowns(slots: list[str]) -> dict[str, str]:
    """Slot -> unknown: the slot's own name (a mere `value` has its stage's), with its stage where two would clash."""
    own = [slot.removesuffix(".value").rpartition(".")[2] for slot in slots]
    return {
        slot: name if own.count(name) == 1 and name != "scene" else slot.replace(".", "_")
        for slot, name in zip(slots, own, strict=True)
    }


def _slot_settings(given: Any, neutral: float | None, where: str) -> dict[str, Any]:
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


def _field(
    settings: Mapping[str, Any],
    shape: tuple[int, ...],
    neutral: float,
    size: Any,
    ratio: float,
    where: str,
    fits: Callable[[tuple[int, ...]], bool],
) -> Field:
    options = {k: v for k, v in settings.items() if k not in SLOT_KEYS}
    kind = str(settings["type"])
    context = {"shape": shape, "neutral": neutral, "size": size, "ratio": ratio}
    if "+" not in kind:
        field = _fitting(kind, options, where, context, fits)
    else:
        members = [name.strip() for name in kind.split("+")]
        if unknown := sorted(set(options) - set(members)):
            raise ConfigError(f"{where}: no option '{unknown[0]}'; {nearest(unknown[0], members)}")
        field = Sum(shape, neutral, {
            name: _fitting(name, options.get(name) or {}, f"{where}.{name}", {**context, "neutral": 0.0}, fits)
            for name in members
        })  # fmt: skip
    if not isinstance(fixed := settings.get("fixed", False), bool):
        raise ConfigError(f"{where}.fixed = {fixed!r}: true or false is needed")
    if fixed:
        field.requires_grad_(False)
    return field


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
    except RuntimeError:  # it cannot even be expanded to the shape
        found = None
    if found is None or not fits(found):
        made = f", not {found}" if found else ""
        raise ConfigError(f"{where}: the field '{kind}' does not fit: {context['shape']} is wanted{made}")
    return field


def _penalties(settings: Mapping[str, Any], where: str, shape: tuple[int, ...]) -> dict[str, Penalty]:
    found, wanted = {}, settings.get("penalties") or {}
    if not isinstance(wanted, Mapping):
        raise ConfigError(
            f"{where}.penalties = {wanted!r}: a mapping is needed, for example {where}.penalties.tv=50"
        )
    for name, given in wanted.items():
        if given is None:  # what a preset has, left out
            continue
        options = {"weight": given} if isinstance(given, int | float | str) else given
        found[name] = make("penalty", name, options, f"{where}.penalties.{name}", shape=shape)
    return found


@torch.no_grad()
def _demand_sense(slot: str, field: Field, where: str) -> None:
    """Raise `ConfigError` for a start that docs/conventions.md rules out."""
    value = field()
    if slot == "gain" and not value.mean() > 0:
        raise ConfigError(f"{where}: a gain has a positive mean, not {float(value.mean()):g}")
    if slot == "tau" and not value.min() > (0 if list(field.parameters()) else -1e-9):
        raise ConfigError(
            f"{where}: a time constant, in ms, is not negative, and one that is to be found starts above zero: "
            f"{where}.init=10"
        )
    matrices = slot == "motion" and value.shape[1:] == (3, 3)
    if matrices and not torch.allclose(value[0], torch.eye(3).to(value), atol=1e-4):
        raise ConfigError(f"{where}: the first frame's motion is the identity, not {value[0].tolist()}")


def _start(
    field: Field, settings: Mapping[str, Any], motion: Tensor | None, geometry: Geometry, where: str
) -> None:
    """Put a slot's field at its `init`: a number, an array's file, or the registered motion."""
    init = settings.get("init", "register" if field.model else None)
    if init == "register":
        if motion is not None:
            field.init_from(scaled(motion, geometry.ratio))
    elif isinstance(init, int | float) and not isinstance(init, bool):
        field.init_from(torch.full(field.shape, float(init)))
    elif isinstance(init, str):
        from deepir.io import read_frames

        value = np.squeeze(read_frames(init).frames)
        try:
            field.init_from(torch.from_numpy(value))
        except RuntimeError as error:
            raise ConfigError(
                f"{where}.init: {init} has shape {value.shape}, {field.shape} is wanted"
            ) from error
    elif init is not None:
        raise ConfigError(
            f"{where}.init = {init!r}: a number, 'register' (a motion), or an array's file is needed"
        )
