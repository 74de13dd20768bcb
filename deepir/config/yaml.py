"""YAML as people mean it: `2:5` is no sexagesimal 125, `1e-3` a number, `no` a word (as in YAML 1.2)."""

from __future__ import annotations

import re
from typing import Any

import yaml

INTEGER = re.compile(r"[-+]?(0|[1-9][0-9]*)$")
NUMBER = re.compile(
    r"[-+]?((\d+\.\d*|\.\d+)([eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$"
)
TRUTH = re.compile(r"(true|True|TRUE|false|False|FALSE)$")
CHANGED = ("int", "float", "bool", "timestamp")
#: Far more than a configuration needs, and little enough for what comes after; aliases count as what they stand for.
LONGEST, MOST, DEEPEST = 100_000, 10_000, 30  # characters, values, levels


class _Loader(yaml.SafeLoader):
    """The safe loader (no Python objects) with plainer scalars; a key given twice is an error."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own way
        first: [each for each in rules if each[0].rpartition(":")[2] not in CHANGED]
        for first, rules in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict[Any, Any]:
        seen: set[Any] = set()
        for key, _ in node.value:
            if not isinstance(key, yaml.ScalarNode):
                raise yaml.MarkedYAMLError(problem="a key is text", problem_mark=key.start_mark)
            if key.value in seen and key.value != "<<":
                raise yaml.MarkedYAMLError(problem=f"key '{key.value}' twice", problem_mark=key.start_mark)
            seen.add(key.value)
        return super().construct_mapping(node, deep)

    def flatten_mapping(self, node: yaml.MappingNode) -> None:
        super().flatten_mapping(node)
        if len(node.value) > MOST:
            raise yaml.MarkedYAMLError(problem=f"more than {MOST:,} values", problem_mark=node.start_mark)


_Loader.add_implicit_resolver("tag:yaml.org,2002:int", INTEGER, list("-+0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER, list("-+0123456789."))
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", TRUTH, list("tTfF"))


def parse(text: str) -> Any:
    """The value of a YAML text; `ValueError` in one line, with the place, if it is none.

    >>> parse("{frames: 2:5, weight: 1e-3, jitter: no}")
    {'frames': '2:5', 'weight': 0.001, 'jitter': 'no'}
    """
    if len(text) > LONGEST:
        raise ValueError(f"{len(text):,} characters; at most {LONGEST:,} are read")
    try:
        value = yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise ValueError(f"nested deeper than {DEEPEST} levels") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        raise ValueError(f"{place}{error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(" ".join(str(error).split())) from None
    _check_extent(value)
    return value


def _check_extent(value: Any) -> None:
    """Raise `ValueError` for what is too much, too deep, or holds itself."""
    level, count = [value], 0
    for _ in range(DEEPEST):
        inner: list[Any] = []
        for each in level:
            inner += (
                [*each, *each.values()] if isinstance(each, dict) else each if isinstance(each, list) else ()
            )
            if count + len(inner) > MOST:
                raise ValueError(f"more than {MOST:,} values")
        count, level = count + len(inner), inner
        if not level:
            return
    raise ValueError(f"nested deeper than {DEEPEST} levels")
