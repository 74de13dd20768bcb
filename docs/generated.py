"""Pages of the reference that are written from the code: `python docs/generated.py` writes them.

Messages are found in the source of the package: calls of errors, of the log, and of `Message`.
"""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, NamedTuple

import deepir
from deepir.config import SHIPPED_CONFIGS, headline, prior_names, shipped_names
from deepir.config.components import options_schema
from deepir.messages import NOTES, WARNINGS
from deepir.registry import components, summary

PACKAGE = Path(deepir.__file__).parent
REFERENCE = Path(__file__).parent / "reference"
COMPONENTS_HEADER = """# Components

What a configuration may name. `deepir list` prints the same, with plugins.
`python docs/generated.py` writes this page.
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
    "effect": ("Effects", "Imperfections that a problem estimates: `effects.NAME` is false, or a mapping of options."),
    "optimiser": (
        "Optimisers",
        "How a group of unknowns moves: `method` of a step of `solver.plan`, and of `scene.fit`.",
    ),
    "problem": ("Problems", "How a problem is started and solved: `problem`."),
    "method": ("Methods", "What runs: `method`. [Methods](methods.md) has their sources."),
    "training": ("Trainings", "What `deepir train NAME` trains."),
    "camera": ("Cameras", "Drivers for `deepir capture --camera NAME`; [cameras](../how-to/cameras.md#take-a-burst)."),
}
MESSAGES_HEADER = """# Messages

Everything that deepir reports, with what to do. `…` stands for a name or a number.
`python docs/generated.py` writes this page from the code.

- A **warning** or a **note** on a result has a name. `warning[motion-small]` is explained [below](#motion-small).
- An **error** ends a command, and nothing is half-written. Its message says what is wrong, where, and what to do.

A command prints the five most important messages on a result. `report.html` and `metrics.json` hold all of them.
In Python they are in `result.messages`, and `message.name` is the name.

| raised as | meaning | exit status |
| --- | --- | --- |
| `ConfigError` | a setting is wrong | 2 |
| `DataError` | a file, or what it holds, cannot be used | 2 |
| `SolverError` | the solve has failed; the last good state is kept | 1 |
| `ValueError` | an argument is wrong; a command reports it as `ConfigError`, after the name of the setting | 2 |

All but the last are `DeepIRError`. An error of a library follows the name of the file or setting.
"""
SEVERITIES = {
    "warning": ("Warnings on a result", "A part of the result is wrong or uncertain.", WARNINGS),
    "note": ("Notes on a result", "The result takes this into account.", NOTES),
}
#: Heading -> description, and the packages and modules whose errors it lists; a module is under the first that fits.
TOPICS = {
    "Cameras and live correction": (
        "`deepir capture` and `deepir live`.",
        ("cameras", "live", "cli.live_frames", "cli.cameras"),
    ),
    "Simulation": ("`data.simulate` and `deepir simulate`.", ("simulate",)),
    "Files and frames": (
        "Reading and writing; `data` in the configuration. A file that is damaged or truncated was not copied or "
        "recorded in full: copy or export it again.",
        ("io", "burst", "calibration", "weights", "cli.recordings"),
    ),
    "Configuration": (
        "A misspelt key is reported as `no option '…'; did you mean '…'?`, a value of the wrong type as "
        "`KEY = VALUE: … is needed`, and a key that must be given as `KEY is missing`.",
        ("config", "build", "registry", "pipeline.schedule", "schedule", "cli.arguments"),
    ),
    "Operators, fields and priors": (
        "Options of `physics`, `scene` and `fidelity`.",
        ("operators", "fields", "priors", "denoisers", "likelihoods"),
    ),
    "Registration and estimation": (
        "Problems, methods and recordings.",
        ("pipeline", "problems", "registration", "recording", "baselines", "optim", "closed_form", "problem"),
    ),
    "Runs and their folders": ("`deepir run` and `deepir resume`.", ("storage", "runner")),
    "Comparisons": ("`deepir compare` and `deepir batch`.", ("sweep", "cli.runs")),
    "Others": ("The command line, and what serves authors of plugins.", ("",)),
}
#: Function -> what it reports.
KINDS = {"warning": "warning", "warn_once": "warning", "_print_error": "error"}


def components_page() -> str:
    """The page in Markdown: deepir's own components, without plugins."""
    parts = [COMPONENTS_HEADER]
    for kind, (title, text) in COMPONENT_KINDS.items():
        found = {name: each for name, each in components(kind).items() if each.__module__.startswith("deepir.")}
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
        "Configurations": ("Shipped: `deepir run NAME`.", {n: SHIPPED_CONFIGS / f"{n}.yaml" for n in shipped_names()}),
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


class Found(NamedTuple):
    """A message in the source: its module, how it is issued, its template, and its name if it is on a result."""

    module: str
    kind: str
    text: str
    name: str = ""


def messages() -> Iterator[Found]:
    """The messages in the package's source, in the order of modules and lines."""
    for path in sorted(PACKAGE.rglob("*.py")):
        module = ".".join(path.relative_to(PACKAGE).with_suffix("").parts)
        nodes = list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))
        raised = {id(node.exc) for node in nodes if isinstance(node, ast.Raise)}
        calls = [node for node in nodes if isinstance(node, ast.Call)]
        for call in sorted(calls, key=lambda node: (node.lineno, node.col_offset)):
            found = _message(call, module, raised=id(call) in raised)
            if found and re.search(r"\w{2}", found.text):  # else it passes on a text from elsewhere
                yield found


def _message(call: ast.Call, module: str, *, raised: bool) -> Found | None:
    """The message that a call issues, or that an exception carries; None if it does something else."""
    function = ast.unparse(call.func).rpartition(".")[2]
    texts = [template(each) for each in (*call.args, *(keyword.value for keyword in call.keywords))]
    if not texts:
        return None
    if function == "Message" and len(texts) == 2:
        return Found(module, "", texts[1], texts[0])
    kind, text = KINDS.get(function, "error" if raised else ""), texts[0]
    if function.endswith("Error"):
        kind = function
    elif function == "notify" and text.startswith(("warning: ", "error: ")):
        kind, _, text = text.partition(": ")
    return Found(module, kind, text) if kind else None


def template(text: ast.expr) -> str:
    """What an expression makes of its constant parts; `…` stands for the others."""
    if isinstance(text, ast.BinOp) and isinstance(text.op, ast.Add):
        parts = template(text.left) + template(text.right)
    elif isinstance(text, ast.JoinedStr):
        parts = "".join(map(template, text.values))
    elif isinstance(text, ast.Constant) and isinstance(text.value, str):
        parts = re.sub(r"%\w", "…", text.value)
    else:
        parts = "…"
    return re.sub("…+", "…", parts)


def messages_page() -> str:
    """The page in Markdown."""
    found = list(messages())
    parts = [MESSAGES_HEADER]
    for severity, (title, description, explanations) in SEVERITIES.items():
        parts.append(f"## {title}\n\n{description}\n")
        for name, (meaning, remedy) in explanations.items():
            texts = dict.fromkeys(each.text for each in found if each.name == name)
            printed = "<br>\n".join(f"`{severity}[{name}]: {text.replace('`', chr(39))}`" for text in texts)
            parts.append(f"### {name}\n\n{printed}\n\n{meaning}\n\n**What to do.** {remedy}\n")
    for title, (description, _) in TOPICS.items():
        rows = dict.fromkeys(
            f"| {_escaped(each.text)} | {each.kind if each.kind.islower() else f'`{each.kind}`'} |"
            for each in found
            if not each.name and _topic(each.module) == title
        )
        table = "\n".join(["| message | raised as |", "| --- | --- |", *rows])
        parts.append(f"## {title}\n\n{description}\n\n{table}\n")
    return "\n".join(parts)


def _topic(module: str) -> str:
    return next(
        title
        for title, (_, prefixes) in TOPICS.items()
        if any(f"{module}.".startswith(f"{prefix}." if prefix else "") for prefix in prefixes)
    )


def _escaped(text: str) -> str:
    """A text in a table's cell, without Markdown but for code."""
    return re.sub(r"([|*_<>\[\]$])", r"\\\1", text)


if __name__ == "__main__":
    for name, page in {"components": components_page, "messages": messages_page}.items():
        (REFERENCE / f"{name}.md").write_text(page(), encoding="utf-8")
