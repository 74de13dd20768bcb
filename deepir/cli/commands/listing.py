"""`deepir list`."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import typer

from deepir.cli.arguments import Plugins, load_plugins
from deepir.cli.terminal import echo


def list_components(
    name: Annotated[
        str | None,
        typer.Argument(
            metavar="NAME", help="A kind, such as fields, or a part of a name.", show_default=False
        ),
    ] = None,
    plugin: Plugins = None,
) -> None:
    """List what configurations may name: methods, operators, fields, penalties, priors, problems ..."""
    load_plugins(plugin)
    from deepir.config import SHIPPED_CONFIGS, headline, prior_names, shipped_names
    from deepir.registry import components, summary

    groups = {
        f"{kind}s".replace("ys", "ies"): {name: summary(each) for name, each in components(kind).items()}
        for kind in (
            "method",
            "operator",
            "field",
            "penalty",
            "denoiser",
            "fidelity",
            "effect",
            "optimiser",
            "problem",
            "training",
            "camera",
        )
    }
    groups["priors (prior=NAME; a field or a .yaml file too)"] = {
        each: headline(SHIPPED_CONFIGS / "prior" / f"{each}.yaml") for each in prior_names()
    }
    groups["configs (deepir run NAME)"] = {
        each: headline(SHIPPED_CONFIGS / f"{each}.yaml") for each in shipped_names()
    }
    groups["effects"] = {
        each: f"{text} {_options(components('effect')[each])}".strip()
        for each, text in groups["effects"].items()
    }
    for title, entries in (groups if name is None else _matching(groups, name)).items():
        echo(f"{title}:")
        for each, text in entries.items():
            echo(f"  {each:<16} {text}")


def _matching(groups: Mapping[str, Mapping[str, str]], name: str) -> Mapping[str, Mapping[str, str]]:
    """The group of a kind, or the entries of all groups whose names hold `name`; `ConfigError` for none."""
    from deepir.errors import ConfigError, nearest

    kinds = {title.partition(" ")[0]: title for title in groups}
    if (
        kind := next((each for each in kinds if each in (name, f"{name}s", f"{name[:-1]}ies")), None)
    ) is not None:
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
