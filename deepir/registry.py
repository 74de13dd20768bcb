"""Short names for components: found in the package's folders, in plugins, and nowhere else.

A configuration never holds an import path: that would be code execution. Third parties add components by the entry
point group `deepir.plugins`, or with `--plugin MODULE` on the command line.
"""

from __future__ import annotations

import functools
import importlib
import importlib.metadata
import pkgutil
from collections.abc import Callable
from typing import Any, TypeVar

from deepir.errors import ConfigError, nearest

T = TypeVar("T")

#: Modules and packages with deepir's components, by kind; all modules of a package are imported.
COMPONENT_MODULES = {
    "method": [
        "deepir.pipeline.bursts",
        "deepir.pipeline.reconstruct",
        "deepir.pipeline.reconstruct",
        "deepir.baselines",
    ],
    "operator": ["deepir.operators"],
    "field": ["deepir.fields", "deepir.priors.networks"],
    "penalty": ["deepir.priors.penalties"],
    "denoiser": ["deepir.denoisers"],
    "fidelity": ["deepir.likelihoods"],
    "effect": ["deepir.effects"],
    "optimiser": ["deepir.optim.adam", "deepir.optim.lbfgs"],
    "problem": ["deepir.problems"],
    "training": ["deepir.training"],
    "camera": ["deepir.cameras"],
}
_components: dict[str, dict[str, Any]] = {kind: {} for kind in COMPONENT_MODULES}


def register(kind: str, name: str) -> Callable[[T], T]:
    """Class or function decorator that registers a component: `@register("operator", "blur")`.

    Raises:
        ValueError: The kind is unknown, or another component has the name.
    """
    if kind not in _components:
        raise ValueError(f"unknown kind of component {kind!r}: {nearest(kind, _components)}")

    def add(component: T) -> T:
        known = _components[kind].get(name)
        if known is not None and _origin(known) != _origin(component):
            raise ValueError(f"{kind} {name!r} is taken by {_origin(known)}")
        _components[kind][name] = component
        return component

    return add


def classes(*kinds: str) -> dict[str, Any]:
    """The registered components of some kinds, by the names of their classes."""
    return {each.__name__: each for kind in kinds for each in components(kind).values()}


def class_named(name: str, module: str, *kinds: str) -> Any:
    """The registered component whose class has a name, as `__getattr__` of a `module` wants it."""
    known = {} if name.startswith("_") else classes(*kinds)
    if name not in known:
        others = f"; {nearest(name, known)}" if known else ""
        raise AttributeError(f"module {module!r} has no attribute {name!r}{others}")
    return known[name]


def lookup(kind: str, name: str, where: str = "") -> Any:
    """The component of a kind and name.

    Args:
        kind: Kind of component, such as `"operator"`.
        name: Its registered name.
        where: Path in the configuration, for messages.

    Raises:
        ConfigError: There is none; the message gives the nearest spelling.
    """
    found = components(kind)
    if name not in found:
        raise ConfigError(f"{where or kind}: no {kind} is called {name!r}; {nearest(name, found)}")
    return found[name]


def components(kind: str) -> dict[str, Any]:
    """All components of a kind by name, deepir's own and the plugins'."""
    for home in COMPONENT_MODULES[kind]:
        _load(home)
    _load_plugins()
    return dict(sorted(_components[kind].items()))


def load_plugin(module: str) -> None:
    """Import a module that registers components.

    Raises:
        ConfigError: It cannot be imported.
    """
    try:
        importlib.import_module(module)
    except Exception as error:  # a plugin may raise anything
        raise ConfigError(f"plugin {module!r} cannot be imported: {_reason(error)}") from error


def summary(component: Any) -> str:
    """The first line of a component's docstring."""
    return (component.__doc__ or "").strip().split("\n")[0]


@functools.cache
def _load(home: str) -> None:
    module = importlib.import_module(home)
    for info in pkgutil.iter_modules(getattr(module, "__path__", [])):
        importlib.import_module(f"{home}.{info.name}")


@functools.cache
def _load_plugins() -> None:
    for entry in importlib.metadata.entry_points(group="deepir.plugins"):
        try:
            entry.load()
        except Exception as error:  # a broken plugin must name itself, whatever it raises
            raise ConfigError(f"plugin {entry.name!r} ({entry.value}) does not load: {_reason(error)}") from error


def _origin(component: Any) -> str:
    return f"{component.__module__}.{component.__qualname__}"


def _reason(error: Exception) -> str:
    """Why a plugin cannot be imported; modules of deepir itself may have moved."""
    moved = isinstance(error, ImportError) and (error.name or "").startswith("deepir.")
    return f"{error}; names of deepir changed, see its CHANGELOG.md" if moved else str(error)
