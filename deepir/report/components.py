"""The table of components: `python -m deepir.report.components docs/reference/components.md` writes it."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from deepir.config import SHIPPED_CONFIGS, headline, prior_names, shipped_names
from deepir.config.components import options_schema
from deepir.registry import components, summary

PAGE_HEADER = """# Components

What a configuration may name. `deepir list` prints the same, with plugins.
`python -m deepir.report.components docs/reference/components.md` writes this page.
[Extending](../how-to/extending.md) says how to add to it.
"""
#: Kind -> heading and description.
COMPONENT_KINDS = {
    "operator": ("Operators", "Stages of `physics`, applied top to bottom. Each slot takes a field."),
    "field": (
        "Fields",
        "How an unknown is represented: `type` of the scene or of a slot. Sums are written `column+row+pixel`.",
    ),
    "penalty": ("Penalties", "Under `penalties` of the scene or of a slot; several may stack."),
    "denoiser": ("Denoisers", "What `red` regularises by: `scene.penalties.red.denoiser`."),
    "fidelity": ("Fidelities", "How prediction and data are compared: `fidelity`."),
    "effect": (
        "Effects",
        "Imperfections that a problem estimates: `effects.NAME` is false, or a mapping of options.",
    ),
    "optimiser": (
        "Optimisers",
        "How a group of unknowns moves: `method` of a step of `solver.plan`, and of `scene.fit`.",
    ),
    "problem": ("Problems", "How a problem is started and solved: `problem`."),
    "method": ("Methods", "What runs: `method`. [Methods](methods.md) has their sources."),
    "training": ("Trainings", "What `deepir train NAME` trains."),
    "camera": (
        "Cameras",
        "Drivers for `deepir capture --camera NAME`; [cameras](../how-to/cameras.md#take-a-burst).",
    ),
}


def components_page() -> str:
    """The page in Markdown: deepir's own components, without plugins."""
    parts = [PAGE_HEADER]
    for kind, (title, text) in COMPONENT_KINDS.items():
        found = {
            name: each for name, each in components(kind).items() if each.__module__.startswith("deepir.")
        }
        columns = ["name", "what", *(["slots"] if kind == "operator" else []), "options"]
        rows = [_row(name, each, kind) for name, each in found.items()]
        if not any(row[-1] for row in rows):
            columns, rows = columns[:-1], [row[:-1] for row in rows]
        parts.append(f"## {title}\n\n{text}\n\n{_table(columns, rows)}")
    shipped = {
        "Priors": (
            "Presets of the scene: `prior`.",
            {n: SHIPPED_CONFIGS / "prior" / f"{n}.yaml" for n in prior_names()},
        ),
        "Configurations": (
            "Shipped: `deepir run NAME`.",
            {n: SHIPPED_CONFIGS / f"{n}.yaml" for n in shipped_names()},
        ),
    }
    for title, (text, files) in shipped.items():
        table = _table(["name", "what"], [[f"`{name}`", headline(path)] for name, path in files.items()])
        parts.append(f"## {title}\n\n{text}\n\n{table}")
    return "\n".join(parts)


def _row(name: str, component: Any, kind: str) -> list[str]:
    slots = [", ".join(f"`{slot}`" for slot in _slots(component))] if kind == "operator" else []
    options = "" if kind in ("problem", "denoiser", "training") else _options(component)
    return [f"`{name}`", summary(component), *slots, options]


def _slots(operator: Any) -> Mapping[str, Any]:
    example, x, _ = operator.example()
    slots: Mapping[str, Any] = example.slots(tuple(x.shape), len(x))
    return slots


def _options(component: Any) -> str:
    """Options with their defaults; a default of None is found from the data, or not used."""
    fields = options_schema(component).model_fields
    return ", ".join(
        f"`{name}`" + (f" ({field.default})" if field.default is not None and not field.is_required() else "")
        for name, field in fields.items()
    )


def _table(columns: list[str], rows: list[list[str]]) -> str:
    """A Markdown table; `|` within a cell is escaped."""
    lines = [columns, ["---"] * len(columns), *([cell.replace("|", "\\|") for cell in row] for row in rows)]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


if __name__ == "__main__":
    Path(sys.argv[1]).write_text(components_page(), encoding="utf-8")
