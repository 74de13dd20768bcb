"""YAML with the scalars of version 1.2: `2:5` is text, not a sexagesimal 125; `1e-3` is a number, `no` is text."""

from __future__ import annotations

import re
from typing import Any

import yaml

#: Scalars by YAML 1.2: decimal integers, numbers, booleans.
INTEGER_PATTERN = re.compile(r"[-+]?(0|[1-9][0-9]*)$")
NUMBER_PATTERN = re.compile(
    r"[-+]?((\d+\.\d*|\.\d+)([eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$"
)
BOOLEAN_PATTERN = re.compile(r"(true|True|TRUE|false|False|FALSE)$")
#: Tags of YAML 1.1 that `_Loader` drops or replaces.
REPLACED_TAGS = ("int", "float", "bool", "timestamp")
MAX_CHARACTERS = 100_000  # length of a YAML text
MAX_VALUES = 10_000  # values of a YAML text, aliases expanded
MAX_DEPTH = 30  # levels of nesting


class _Loader(yaml.SafeLoader):
    """The safe loader (no Python objects) with these scalars; duplicate keys are errors."""

    yaml_implicit_resolvers = {  # noqa: RUF012 - PyYAML's own way
        first: [each for each in rules if each[0].rpartition(":")[2] not in REPLACED_TAGS]
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
        if len(node.value) > MAX_VALUES:
            raise yaml.MarkedYAMLError(
                problem=f"more than {MAX_VALUES:,} values", problem_mark=node.start_mark
            )


_Loader.add_implicit_resolver("tag:yaml.org,2002:int", INTEGER_PATTERN, list("-+0123456789"))
_Loader.add_implicit_resolver("tag:yaml.org,2002:float", NUMBER_PATTERN, list("-+0123456789."))
_Loader.add_implicit_resolver("tag:yaml.org,2002:bool", BOOLEAN_PATTERN, list("tTfF"))


def parse_yaml(text: str) -> Any:
    """The value of a YAML text.

    >>> parse_yaml("{frames: 2:5, weight: 1e-3, jitter: no}")
    {'frames': '2:5', 'weight': 0.001, 'jitter': 'no'}

    Raises:
        ValueError: It is not YAML, or too large; one line, with the place.
    """
    if len(text) > MAX_CHARACTERS:
        raise ValueError(f"{len(text):,} characters; at most {MAX_CHARACTERS:,} are read")
    try:
        value = yaml.load(text, Loader=_Loader)
    except RecursionError:
        raise ValueError(f"nested deeper than {MAX_DEPTH} levels") from None
    except yaml.MarkedYAMLError as error:
        mark = error.problem_mark
        place = f"line {mark.line + 1}, column {mark.column + 1}: " if mark is not None else ""
        raise ValueError(f"{place}{error.problem or error.context}") from None
    except (yaml.YAMLError, ValueError) as error:
        raise ValueError(" ".join(str(error).split())) from None
    _check_extent(value)
    return value


def _check_extent(value: Any) -> None:
    """Raise `ValueError` for too many values, too deep nesting, or a value that contains itself."""
    level, count = [value], 0
    for _ in range(MAX_DEPTH):
        inner: list[Any] = []
        for each in level:
            inner += (
                [*each, *each.values()] if isinstance(each, dict) else each if isinstance(each, list) else ()
            )
            if count + len(inner) > MAX_VALUES:
                raise ValueError(f"more than {MAX_VALUES:,} values")
        count, level = count + len(inner), inner
        if not level:
            return
    raise ValueError(f"nested deeper than {MAX_DEPTH} levels")
