"""Make components from configuration: the constructor's signature is the schema."""

from __future__ import annotations

import functools
import inspect
import typing
from collections.abc import Mapping
from typing import Any

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from deepir.errors import ConfigError, nearest
from deepir.registry import lookup

#: Arguments that the problem supplies, never a configuration.
CONTEXT = frozenset({"shape", "neutral", "size", "canvas", "origin", "members"})


def make(kind: str, name: str, options: Mapping[str, Any], where: str, **context: Any) -> Any:
    """The component `name`, with its `options` checked against its signature.

    `where` is the path in the configuration that errors name; `context` holds what the constructor may want of
    the problem at hand (shape, size, ...).

    Raises:
        ConfigError: Unknown component, unknown option, wrong type or a value that the component refuses.
    """
    component = lookup(kind, name, where)
    accepted = inspect.signature(component).parameters
    values = validate(options_schema(component), options, f"{where} ({kind} {name!r})")
    supplied = {key: value for key, value in context.items() if key in accepted}
    try:
        return component(**supplied, **values)
    except (ValueError, ConfigError) as error:
        raise ConfigError(f"{where}: {error}") from error


@functools.cache
def options_schema(component: Any) -> type[BaseModel]:
    """What a configuration may set: the constructor's arguments less the context, with types and defaults."""
    hints = typing.get_type_hints(component.__init__ if inspect.isclass(component) else component)
    fields: dict[str, Any] = {
        name: (hints.get(name, Any), ... if p.default is p.empty else p.default)
        for name, p in inspect.signature(component).parameters.items()
        if name not in CONTEXT and p.kind is p.KEYWORD_ONLY
    }
    return create_model(component.__name__, __config__=ConfigDict(extra="forbid"), **fields)


def validate(schema: type[BaseModel], options: Mapping[str, Any], where: str) -> dict[str, Any]:
    """The options with defaults filled in; `ConfigError` with the path, what is allowed and the nearest spelling.

    `auto` stands for "not given".
    """
    given = {key: value for key, value in options.items() if value != "auto"}
    try:
        checked = schema.model_validate(given)
    except ValidationError as error:
        raise ConfigError(explain(error, schema, where)) from None
    return {name: getattr(checked, name) for name in schema.model_fields}


def explain(error: ValidationError, schema: type[BaseModel], where: str) -> str:
    """The first thing wrong, as one line."""
    first = error.errors()[0]
    path = ".".join(str(part) for part in first["loc"])
    if first["type"] == "extra_forbidden":
        return f"{where}: no option '{path}'; {nearest(str(first['loc'][-1]), _allowed(schema, first['loc']))}"
    if first["type"] == "missing":
        return f"{where}: '{path}' is missing"
    return f"{where}: '{path}' = {first['input']!r}: {first['msg'][:1].lower()}{first['msg'][1:]}"


def _allowed(schema: type[BaseModel], loc: tuple[int | str, ...]) -> list[str]:
    """Names allowed at the level of the wrong key."""
    for step in loc[:-1]:
        field = schema.model_fields.get(str(step))
        inner = field.annotation if field is not None else None
        nested = [t for t in (inner, *typing.get_args(inner)) if inspect.isclass(t) and issubclass(t, BaseModel)]
        if not nested:
            return []
        schema = nested[0]
    return list(schema.model_fields)
