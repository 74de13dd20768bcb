"""Configurations: YAML files merged with presets and `key=value` overrides, checked before anything runs."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import ValidationError

from deepir.config import overrides
from deepir.config.components import explain
from deepir.config.overrides import parse_yaml
from deepir.config.schema import Config
from deepir.errors import ConfigError, nearest
from deepir.paths import expanded, is_file

PACKAGED_CONFIGS = Path(__file__).parent.parent / "configs"  # shipped configurations in the wheel
SHIPPED_CONFIGS = (
    PACKAGED_CONFIGS if PACKAGED_CONFIGS.is_dir() else Path(__file__).parents[2] / "configs"
)  # the same in a checkout
#: Reference to another key: `${data.path}`, or `${.path}` from within `data`.
REFERENCE_PATTERN = re.compile(r"\$\{\.*\w+(\.\w+)*\}")


def load(
    config: str | Path | Mapping[str, Any], changes: Sequence[str] = (), options: Mapping[str, Any] | None = None
) -> Config:
    """Load a configuration from a path, a shipped name (`nuc`) or a mapping.

    Args:
        config: The path, name or mapping.
        changes: `key=value`, applied last; see `deepir.config.overrides`.
        options: Top-level keys, merged over `config`.

    Raises:
        ConfigError: Unknown name, broken YAML, unknown key or wrong value; the message gives the key's path.
    """
    if not isinstance(config, str | os.PathLike | Mapping):
        raise ConfigError(f"configuration: {config!r}: a shipped name, a path or a mapping is needed")
    label = "configuration" if isinstance(config, Mapping) else str(config)
    base = _merge(label, config if isinstance(config, Mapping) else _read(find(config)), options or {})
    pairs = overrides.parse_settings(changes, Config)
    prior = (base | dict(pairs)).get("prior") or Config.model_fields["prior"].default
    whole = _merge(label, _preset(str(prior)), base)
    for key, value in pairs:
        overrides.apply_setting(whole, key, value)
    checked = _check(_merge(label, whole, resolve=True), label, changes)
    _order_stages(checked, list(base.get("physics") or {}), label)
    return checked


def read(path: Path) -> Config:
    """Read a configuration that `dump` wrote; it is complete, so presets are not merged."""
    return _check(_read(path), str(path))


def dump(config: Config) -> str:
    """The configuration as YAML for `read` and `load`."""
    return OmegaConf.to_yaml(OmegaConf.create(config.model_dump()))


def find(name: str | Path) -> Path:
    """The file of a configuration, by its path or its shipped name.

    Raises:
        ConfigError: There is none; the message gives the nearest spelling.
    """
    path = expanded(name)
    if str(name) in shipped_names() and not is_file(path):
        return SHIPPED_CONFIGS / f"{name}.yaml"
    if path.suffix in (".yaml", ".yml") and is_file(path):
        return path
    if os.path.exists(path):  # noqa: PTH110 - however long
        use = f"resume {name}" if (path / "config.yaml").is_file() else f"run nuc data.path={name}"
        raise ConfigError(f"{name}: not a configuration (a .yaml file); did you mean `deepir {use}`?")
    here = [str(each) for each in path.parent.glob("*.y*ml")] if path.parent.is_dir() else []
    raise ConfigError(
        f"no configuration '{name}'; {nearest(str(name), [*shipped_names(), *here])}, or another .yaml file"
    )


def shipped_names() -> list[str]:
    """Names of the shipped configurations, without presets of priors."""
    found = (path.relative_to(SHIPPED_CONFIGS).with_suffix("").as_posix() for path in SHIPPED_CONFIGS.rglob("*.yaml"))
    return sorted(name for name in found if not name.startswith("prior/"))


def prior_names() -> list[str]:
    """Names of the priors' presets."""
    return sorted(path.stem for path in (SHIPPED_CONFIGS / "prior").glob("*.yaml"))


def headline(path: Path) -> str:
    """The comment in the first line of a configuration's file."""
    lines = path.read_text(encoding="utf-8").splitlines()
    return lines[0].lstrip("# ") if lines and lines[0].startswith("#") else ""


def _read(path: Path) -> dict[str, Any]:
    try:
        parsed = parse_yaml(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError:
        raise ConfigError(f"{path}: not a text file") from None
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}") from None
    except ValueError as error:
        raise ConfigError(f"{path}: broken YAML: {error}") from None
    if not isinstance(parsed, dict):
        raise ConfigError(f"{path}: a configuration is a mapping of keys to values; `deepir list` shows examples")
    return parsed


def _merge(label: str, *parts: Mapping[str, Any], resolve: bool = False) -> dict[str, Any]:
    try:
        merged: dict[str, Any] = functools.reduce(_overlay, parts, {})
        _check_texts(merged, label)
        return OmegaConf.to_container(OmegaConf.create(merged), resolve=resolve, throw_on_missing=resolve)  # type: ignore[return-value]
    except (OmegaConfBaseException, RecursionError) as error:
        raise ConfigError(f"{label}: {str(error).splitlines()[0]}") from None


def _check_texts(value: Any, where: str) -> None:
    """Raise `ConfigError` for a text that could not be written to a file, or that is more than a reference to a key.

    OmegaConf's resolvers, such as `${oc.env:TOKEN}`, would put secrets of the environment into results.
    """
    if isinstance(value, Mapping):
        for key, each in value.items():
            _check_texts(each, f"{where}: {key}")
    elif isinstance(value, list):
        for each in value:
            _check_texts(each, where)
    elif isinstance(value, str):
        if any("\ud800" <= letter <= "\udfff" for letter in value):
            raise ConfigError(f"{where}: {value}: this name is not UTF-8; rename the file")
        if "${" in REFERENCE_PATTERN.sub("", value):
            raise ConfigError(f"{where}: '{value}': only another key may be named, as in ${{data.path}}")


def _overlay(under: Any, over: Any, where: str = "") -> Any:
    """The value `over`, merged over `under` where both are mappings.

    For a caller in Python, paths become text, and scalars of NumPy or of torch numbers. `OmegaConf.merge` raises a bare
    TypeError for some combinations; this names the key.

    Raises:
        ConfigError: A key is no text, or a value is an array.
    """
    if isinstance(over, list | tuple):
        return [_overlay(None, each, f"{where}{i}.") for i, each in enumerate(over)]
    if isinstance(over, os.PathLike):
        return os.fspath(over)
    if getattr(over, "ndim", 0) > 0:
        raise ConfigError(
            f"an array of shape {tuple(over.shape)} in the options: save it, and give the name of its file"
        )
    if hasattr(over, "ndim"):
        return over.item()
    if not isinstance(over, Mapping):
        return over
    if wrong := [key for key in over if not isinstance(key, str)]:
        raise ConfigError(f"{where}{wrong[0]!r}: a key is text")
    below = under if isinstance(under, Mapping) else {}
    return {**below, **{key: _overlay(below.get(key), each, f"{where}{key}.") for key, each in over.items()}}


def _check(whole: Mapping[str, Any], label: str, changes: Sequence[str] = ()) -> Config:
    try:
        return Config.model_validate(whole)
    except ValidationError as error:
        path, problem = explain(error, Config, whole)
        own = next(
            (f"'{each}'" for each in reversed(changes) if f"{path}.".startswith(f"{each.split('=')[0]}.")), label
        )
        raise ConfigError(f"{own}: {problem}") from None


def _preset(name: str) -> dict[str, Any]:
    """Configuration of `prior: name`: a shipped preset, a .yaml file, or a field without penalties."""
    own = expanded(name)
    if name in prior_names():
        return _read(SHIPPED_CONFIGS / "prior" / f"{name}.yaml")
    if own.suffix in (".yaml", ".yml"):
        if not is_file(own):
            raise ConfigError(f"prior: {name}: no such file; give a .yaml file or a name: {', '.join(prior_names())}")
        given = _read(own)
        if unknown := next((key for key in given if key not in Config.model_fields), None):
            raise ConfigError(f"{name}: no option '{unknown}'; a prior's file holds `scene:`")
        return given

    from deepir.registry import components  # not above: `deepir --help` does without torch

    if name in components("field"):
        return {"scene": {"type": name, "init": "average"}}
    raise ConfigError(
        f"prior: no prior is called '{name}'; {nearest(name, prior_names())}, a field's name or a .yaml file"
    )


def _order_stages(config: Config, in_file: list[str], label: str) -> None:
    """Move stages with `before` to their place; a stage that an override adds must have it."""
    stages = config.physics
    for name in list(stages):
        options = stages[name] = dict(stages[name] or {})
        target = options.pop("before", None)
        if target is None:
            if name not in in_file:
                raise ConfigError(
                    f"physics.{name}: not a stage of {label}; {nearest(name, in_file)}. "
                    "A new stage must say where it goes, for example "
                    f"physics.{name}.before={in_file[-1] if in_file else 'STAGE'}"
                )
            continue
        if target not in stages or target == name:
            others = [each for each in stages if each != name]
            raise ConfigError(f"physics.{name}.before: no stage '{target}'; {nearest(str(target), others)}")
        own = stages.pop(name)
        rest = list(stages.items())
        index = [key for key, _ in rest].index(target)
        stages.clear()
        stages.update([*rest[:index], (name, own), *rest[index:]])
