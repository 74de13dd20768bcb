"""From a slot's part of a configuration to the field and the penalties of its unknown."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import torch
from torch import Tensor

from deepir.config.components import make
from deepir.errors import ConfigError, nearest
from deepir.fields.base import Field
from deepir.fields.constant import Constant
from deepir.fields.sensor_maps import SumField
from deepir.operators.motion_models import Geometry, rescale_motion
from deepir.priors.penalties.base import Penalty

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


def shared_field(
    name: str, known: Mapping[str, Field], where: str, fits: Callable[[tuple[int, ...]], bool]
) -> Field:
    """The field of an unknown of another data set; `ConfigError` if there is none, or none that fits."""
    if name not in known:
        raise ConfigError(
            f"{where}.unknown: no unknown '{name}' in the data sets before; {nearest(name, known)}"
        )
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
