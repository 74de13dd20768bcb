"""Overrides of a configuration, and YAML with places for messages."""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from typing import Any, get_args

import yaml
from pydantic import BaseModel

from deepir.config.components import annotation_of
from deepir.errors import ConfigError, nearest

INTEGER_PATTERN = re.compile(r"[-+]?(0|[1-9][0-9]*)$")  # scalars by YAML 1.2: decimal integers, numbers, booleans
NUMBER_PATTERN = re.compile(r"[-+]?((\d+\.\d*|\.\d+)([eE][-+]?\d+)?|\d+[eE][-+]?\d+|\.(inf|Inf|INF))$|\.(nan|NaN|NAN)$")
BOOLEAN_PATTERN = re.compile(r"(true|True|TRUE|false|False|FALSE)$")
REPLACED_TAGS = ("int", "float", "bool", "timestamp")  # tags of YAML 1.1 that `_Loader` drops or replaces
MAX_CHARACTERS = 100_000  # length of a YAML text
MAX_VALUES = 10_000  # values of a YAML text, aliases expanded
MAX_DEPTH = 30  # levels of nesting
#: Sections that name components, whose keys the schema does not know.
COMPONENT_SECTIONS = ("physics", "scene", "fidelity", "method")


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
            raise yaml.MarkedYAMLError(problem=f"more than {MAX_VALUES:,} values", problem_mark=node.start_mark)


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
            inner += [*each, *each.values()] if isinstance(each, dict) else each if isinstance(each, list) else ()
            if count + len(inner) > MAX_VALUES:
                raise ValueError(f"more than {MAX_VALUES:,} values")
        count, level = count + len(inner), inner
        if not level:
            return
    raise ValueError(f"nested deeper than {MAX_DEPTH} levels")


def parse_settings(pairs: Sequence[str], schema: type[BaseModel]) -> list[tuple[str, Any]]:
    """Split `key=value` pairs and parse their values as YAML.

    Args:
        pairs: The pairs.
        schema: Schema of the configuration; values of text keys are not parsed.

    Raises:
        ConfigError: A pair is not `key=value`, or its value is not YAML.
    """
    found = []
    for pair in pairs:
        if not isinstance(pair, str):
            raise ConfigError(f"{pair!r}: a setting is text, such as 'data.path=burst.npz'")
        key, equals, text = (part.strip() for part in pair.partition("="))
        if not equals or not all(key.split(".")):
            hint = (
                f"did you mean data.path={pair}?"
                if os.path.exists(pair)  # noqa: PTH110 - however long
                else "for example data.path=burst.npz"
            )
            raise ConfigError(f"'{pair}': a setting is key=value; {hint}")
        if not text:
            raise ConfigError(f"'{pair}': the value is missing ({key}=null takes the default)")
        kind = annotation_of(schema, key)
        if kind in (str, str | None):
            found.append((key, None if text == "null" else text))
            continue
        try:
            value = parse_yaml(text)
        except ValueError as error:
            raise ConfigError(f"'{pair}': not a YAML value: {error}") from None
        # A slice without an end, data.frames=2:, is a mapping of YAML.
        found.append((key, text if text.endswith(":") and str in get_args(kind) else value))
    return found


def apply_setting(whole: dict[str, Any], key: str, value: Any) -> None:
    """Apply one setting to a configuration in place.

    Raises:
        ConfigError: There is nothing at `key` to remove or to change.
    """
    *path, last = key.split(".")
    node: Any = whole
    for depth, part in enumerate(path, 1):
        step = _index(node, part, key)
        if isinstance(node, dict) and node.get(step) is None:
            node[step] = {}
        elif isinstance(node[step], str) and path[0] in COMPONENT_SECTIONS:
            node[step] = {"type": node[step]}
        node = node[step]
        if not isinstance(node, dict | list):
            raise ConfigError(f"{key}: {'.'.join(path[:depth])} is {node!r}, which has no keys")
    last = _index(node, last, key)
    there = node.get(last) if isinstance(node, dict) else None
    if value is None and (isinstance(node, list) or last in node):
        del node[last]
    elif value is None and key.partition(".")[0] in COMPONENT_SECTIONS:
        raise ConfigError(f"{key}=null: there is no '{last}' to remove; {nearest(str(last), map(str, node))}")
    elif isinstance(value, str) and isinstance(there, dict) and "type" in there:
        there["type"] = value
    else:
        node[last] = value  # of null, for the schema to judge


def _index(node: Any, part: str, key: str) -> Any:
    if isinstance(node, dict):
        return part
    if part.isdecimal() and int(part) < len(node):
        return int(part)
    raise ConfigError(f"{key}: no entry '{part}' in a list of {len(node)}; entries are counted from 0")
