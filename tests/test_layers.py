"""The structure of the package: a folder imports only folders below it."""

import ast
import functools
from collections import defaultdict
from pathlib import Path

import deepir

PACKAGE = Path(deepir.__file__).parent
#: The numeric core: no configuration, no result files, no report, no command line.
CORE = {
    "kernels",
    "arrays",
    "operators",
    "closed_form",
    "likelihoods",
    "problem",
    "registered_average",
    "schedule",
    "optim",
    "estimation",
    "effects",
    "registration",
    "multiview",
    "diagnostics",
}
ABOVE_THE_CORE = {
    "config",
    "burst",
    "result",
    "report",
    "storage",
    "sweep",
    "cli",
    "runner",
    "api",
    "pipeline",
    "problems",
    "build",
    "baselines",
}


def modules():
    for path in sorted(PACKAGE.rglob("*.py")):
        parts = path.relative_to(PACKAGE.parent).with_suffix("").parts
        yield ".".join(parts).removesuffix(".__init__"), path


def imported(path, known):
    """Modules that a file imports when it runs: those for type checkers only are left out."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    hidden = {
        id(inner)
        for node in ast.walk(tree)
        if isinstance(node, ast.If) and "TYPE_CHECKING" in ast.unparse(node.test)
        for inner in ast.walk(node)
    }
    for node in ast.walk(tree):
        if id(node) in hidden:
            continue
        if isinstance(node, ast.ImportFrom) and node.module:
            for each in node.names:
                whole = f"{node.module}.{each.name}"
                yield whole if whole in known else node.module
        elif isinstance(node, ast.Import):
            yield from (each.name for each in node.names)


@functools.cache
def imports():
    """Of each module, what it imports of the package."""
    known = dict(modules())
    return {module: known.keys() & imported(path, known) for module, path in known.items()}


def graph(of=lambda module: module):
    found = defaultdict(set)
    for module, others in imports().items():
        found[of(module)] |= {of(other) for other in others} - {of(module)}
    return found


def folder(module):
    """The folder of a module below the package, or the file where it lies in the package itself."""
    return module.split(".")[1] if "." in module else module


def circles(edges):
    """Peel off what imports nothing that is left; what cannot be peeled is in a circle, or imports one."""
    left = set(edges) | {other for others in edges.values() for other in others}
    while free := {each for each in left if not edges.get(each, set()) & left}:
        left -= free
    return left


def test_no_circle_of_files_or_folders():
    assert not circles(graph())
    assert not circles(graph(folder))


def test_the_numeric_core_knows_no_configuration_and_no_report():
    edges = graph(folder)
    assert {core: sorted(edges[core] & set(ABOVE_THE_CORE)) for core in CORE if edges[core] & set(ABOVE_THE_CORE)} == {}


def test_a_circle_is_found():
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}}) == {"a", "b", "c"}
