"""`deepir list`."""

from __future__ import annotations

from typing import Any

from deepir.cli.arguments import Plugins, load_plugins
from deepir.cli.terminal import echo


def list_components(plugin: Plugins = None) -> None:
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
        name: headline(SHIPPED_CONFIGS / "prior" / f"{name}.yaml") for name in prior_names()
    }
    groups["configs (deepir run NAME)"] = {
        name: headline(SHIPPED_CONFIGS / f"{name}.yaml") for name in shipped_names()
    }
    groups["effects"] = {
        name: f"{text} {_options(components('effect')[name])}".strip()
        for name, text in groups["effects"].items()
    }
    for title, entries in groups.items():
        echo(f"{title}:")
        for name, text in entries.items():
            echo(f"  {name:<16} {text}")


def _options(component: Any) -> str:
    """Options and their defaults in brackets; nothing without options."""
    from deepir.config.components import options_schema

    fields = options_schema(component).model_fields
    named = ", ".join(f"{name}={field.default}" for name, field in fields.items())
    return f"({named})" if named else ""
