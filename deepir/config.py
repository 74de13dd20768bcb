"""Configurations: YAML files merged with presets and `key=value` overrides, checked before anything runs."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from pydantic import BaseModel, ConfigDict, Field, ValidationError
from yaml import YAMLError

from deepir.components import explain
from deepir.errors import ConfigError

PACKED = Path(__file__).parent / "configs"  # in the wheel
SHIPPED = PACKED if PACKED.is_dir() else Path(__file__).parent.parent / "configs"  # in a checkout


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid")


class Data(_Strict):
    """Where the frames come from."""

    path: str | None = None  # file, folder or glob
    truth: str | None = None  # .npz with `scene`, or a picture: scores are added to metrics.json
    mask: str | None = None  # picture or array of a frame's size; nonzero = ignore
    crop: list[int] | None = None  # [y0, y1, x0, x1], applied to frames and mask
    frames: str | int | list[int] | None = None  # the first n, a slice a:b, or a list
    key: str | None = None  # array in an .npz


class Noise(_Strict):
    """Noise of a sample: variance `read² + y / photons`."""

    read: float = Field(ge=0)  # standard deviation, in the data's units
    photons: float | None = Field(None, gt=0)  # photons for each unit of data; None: no photon noise


class StepConfig(_Strict):
    """A step of a stage, see `deepir.solve.Step`."""

    group: list[str]
    method: Literal["lbfgs", "adam", "eliminate"] = "lbfgs"
    lr: float = Field(1e-2, gt=0)
    every: int = Field(1, ge=1)


class StageConfig(_Strict):
    """A stage of the plan, see `deepir.solve.Stage`."""

    name: str
    steps: list[StepConfig]
    iterations: int = Field(100, ge=0)


class Solver(_Strict):
    """How long, and in which order."""

    max_iterations: int | None = Field(None, ge=0)  # caps each stage
    plan: list[StageConfig] | None = None  # None: the problem's own


class Output(_Strict):
    """Where results go."""

    dir: str | None = None


class Config(_Strict):
    """A whole configuration; `physics`, `scene` and `fidelity` are checked against the components they name."""

    problem: str = "generic"
    method: str = "joint"
    prior: str = "tv"
    scene: dict[str, Any] = {}
    physics: dict[str, dict[str, Any] | None]
    fidelity: str | dict[str, Any] = "gaussian"
    noise: Literal["auto"] | Noise = "auto"
    data: Data = Data()
    solver: Solver = Solver()
    output: Output = Output()
    seed: int = Field(0, ge=0)
    device: str = "cpu"
    threads: int | None = Field(None, ge=1)


def load(config: str | Path | Mapping[str, Any], overrides: Sequence[str] = ()) -> Config:
    """A configuration from a path, a shipped name (`nuc`) or a mapping, with `key=value` overrides.

    Raises:
        ConfigError: Unknown name, broken YAML, unknown key or wrong value; the message gives the key's path.
    """
    base = _parse(dict(config)) if isinstance(config, Mapping) else _parse(find(config))
    changes = _overrides(overrides)
    merged = _merge(base, changes)
    name = merged.get("prior", Config.model_fields["prior"].default)
    preset = _parse(_preset(str(name)))
    merged = _merge(preset, base, changes)
    try:
        plain = OmegaConf.to_container(merged, resolve=True, throw_on_missing=True)
        checked = Config.model_validate(plain)
    except ValidationError as error:
        raise ConfigError(explain(error, Config, _label(config))) from None
    except OmegaConfBaseException as error:
        raise ConfigError(f"{_label(config)}: {str(error).splitlines()[0]}") from None
    _order(checked, list(base.get("physics") or {}), _label(config))
    return checked


def find(name: str | Path) -> Path:
    """The file of a configuration, given its path or its shipped name."""
    path, shipped = Path(name), SHIPPED / f"{name}.yaml"
    if path.suffix in (".yaml", ".yml") or path.is_file():
        if not path.is_file():
            raise ConfigError(f"{path}: no such configuration file; shipped ones: {', '.join(shipped_names())}")
        return path
    if not shipped.is_file():
        close = difflib.get_close_matches(str(name), shipped_names(), n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise ConfigError(f"no configuration '{name}'; {hint}Shipped: {', '.join(shipped_names())}")
    return shipped


def shipped_names() -> list[str]:
    """Names of the shipped configurations, presets of priors left out."""
    found = (path.relative_to(SHIPPED).with_suffix("").as_posix() for path in SHIPPED.rglob("*.yaml"))
    return sorted(name for name in found if not name.startswith("prior/"))


def priors() -> list[str]:
    """Names of the priors' presets."""
    return sorted(path.stem for path in (SHIPPED / "prior").glob("*.yaml"))


def dump(config: Config) -> str:
    """The configuration as YAML that `load` reads back."""
    return OmegaConf.to_yaml(OmegaConf.create(config.model_dump(exclude_none=True)))


def _parse(source: Path | dict[str, Any]) -> Any:
    label = "configuration" if isinstance(source, dict) else str(source)
    try:
        parsed = OmegaConf.create(source) if isinstance(source, dict) else OmegaConf.load(source)
    except (YAMLError, OmegaConfBaseException, UnicodeDecodeError, OSError) as error:
        raise ConfigError(f"{label}: not readable as YAML: {' '.join(str(error).split())}") from None
    if not OmegaConf.is_dict(parsed):
        raise ConfigError(f"{label}: a configuration is a mapping of keys to values")
    return parsed


def _overrides(pairs: Sequence[str]) -> Any:
    for pair in pairs:
        if "=" not in pair or pair.startswith("="):
            raise ConfigError(f"'{pair}': an override is key=value, for example data.path=burst.npz")
    try:
        return OmegaConf.from_dotlist(list(pairs))
    except (YAMLError, OmegaConfBaseException) as error:
        raise ConfigError(f"overrides {list(pairs)}: {' '.join(str(error).split())}") from None


def _merge(*parts: Any) -> Any:
    try:
        return OmegaConf.merge(*parts)
    except OmegaConfBaseException as error:
        raise ConfigError(f"an override does not fit the configuration: {str(error).splitlines()[0]}") from None


def _preset(name: str) -> Path:
    path = SHIPPED / "prior" / f"{name}.yaml"
    if name not in priors():
        close = difflib.get_close_matches(name, priors(), n=1)
        hint = f"did you mean '{close[0]}'? " if close else ""
        raise ConfigError(f"prior: no prior is called '{name}'; {hint}Allowed: {', '.join(priors())}")
    return path


def _order(config: Config, in_file: list[str], label: str) -> None:
    """Put stages that say `before` where they belong; one that an override adds must say it."""
    stages = config.physics
    for name in list(stages):
        options = stages[name] = dict(stages[name] or {})
        target = options.pop("before", None)
        if target is None:
            if name not in in_file:
                raise ConfigError(
                    f"physics.{name}: not a stage of {label} ({', '.join(in_file)}); a stage that is added must say "
                    f"where it goes, for example physics.{name}.before={in_file[-1] if in_file else 'STAGE'}"
                )
            continue
        if target not in stages or target == name:
            raise ConfigError(f"physics.{name}.before: no stage '{target}'; stages: {', '.join(stages)}")
        own = stages.pop(name)
        rest = list(stages.items())
        index = [key for key, _ in rest].index(target)
        stages.clear()
        stages.update([*rest[:index], (name, own), *rest[index:]])


def _label(config: str | Path | Mapping[str, Any]) -> str:
    return "configuration" if isinstance(config, Mapping) else str(config)
