"""`key=value` on the command line: what it changes in a configuration.

- A value is YAML; where the schema has text (`data.path`), it is taken as it stands.
- `key=null` removes the key: its default comes back, a stage or penalty goes, a slot becomes neutral.
- A name in place of a component changes its type only: `physics.warp.motion=affine` keeps `init: register`.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from typing import Any, get_args

from pydantic import BaseModel

from deepir.config.components import annotation_of
from deepir.config.yaml import parse_yaml
from deepir.errors import ConfigError, nearest

#: Sections that name components, whose keys the schema does not know.
COMPONENT_SECTIONS = ("physics", "scene", "fidelity", "method")


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
    for depth, part in enumerate(path):
        node = _inner(node, part, ".".join(path[: depth + 1]), key)
    last = _index(node, last, key)
    if value is None:
        _remove(node, last, key)
    elif isinstance(value, str) and isinstance(node, dict) and "type" in _mapping(node.get(last)):
        node[last]["type"] = value
    else:
        node[last] = value


def _inner(node: Any, part: str, where: str, key: str) -> Any:
    """The value of `node` under `part`, as a mapping or list."""
    step = _index(node, part, key)
    if isinstance(node, dict) and node.get(step) is None:
        node[step] = {}
    elif isinstance(node[step], str) and where.partition(".")[0] in COMPONENT_SECTIONS:
        node[step] = {"type": node[step]}
    if not isinstance(node[step], dict | list):
        raise ConfigError(f"{key}: {where} is {node[step]!r}, which has no keys")
    return node[step]


def _index(node: Any, part: str, key: str) -> Any:
    if isinstance(node, dict):
        return part
    if part.isdecimal() and int(part) < len(node):
        return int(part)
    raise ConfigError(f"{key}: no entry '{part}' in a list of {len(node)}; entries are counted from 0")


def _remove(node: Any, last: Any, key: str) -> None:
    if isinstance(node, list) or last in node:
        del node[last]
    elif key.partition(".")[0] in COMPONENT_SECTIONS:
        raise ConfigError(f"{key}=null: there is no '{last}' to remove; {nearest(str(last), map(str, node))}")
    else:
        node[last] = None  # for the schema to judge


def _mapping(value: Any) -> dict[str, Any]:
    return value if isinstance(value, dict) else {}
