"""Make components from a configuration: the constructor's signature is the schema."""

from __future__ import annotations

import functools
import inspect
import types
import typing
from collections.abc import Iterator, Mapping
from typing import Any, Literal, Union

from pydantic import BaseModel, ConfigDict, ValidationError, create_model

from deepir.errors import ConfigError, DeepIRError, nearest
from deepir.registry import lookup

#: Arguments that the problem or the run supplies, never a configuration.
CONTEXT_ARGUMENTS = frozenset(
    {"shape", "neutral", "size", "canvas", "origin", "ratio", "anchored", "members", "fps", "instants"}
    | {"burst", "config", "callbacks", "checkpoint"}
    | {"problem", "group", "evaluate"}
)
#: How messages describe a value of a type.
TYPE_DESCRIPTIONS = {int: "a whole number", float: "a number", str: "text", bool: "true or false", type(None): "null"}
#: Names that pydantic gives to the branches of a union of scalars.
SCALAR_TYPE_NAMES = frozenset(kind.__name__ for kind in TYPE_DESCRIPTIONS)
#: How messages describe the elements of a list.
ELEMENT_DESCRIPTIONS = {int: "whole numbers", float: "numbers", str: "names"}


def make(kind: str, name: str, options: Mapping[str, Any], where: str, **context: Any) -> Any:
    """Make the component `name` with its options checked against its signature.

    Args:
        kind: Kind of component, such as `"penalty"`.
        name: Its registered name.
        options: Its options from the configuration.
        where: Path in the configuration, for messages.
        context: Arguments that the problem at hand supplies (shape, size ...); those that it does not take are dropped.

    Raises:
        ConfigError: Unknown component, unknown option, wrong type, or a value that the component refuses.
    """
    component = lookup(kind, name, where)
    accepted = _arguments(component)
    values = validate(options_schema(component), options, f"{where} ({kind} '{name}')")
    supplied = {key: value for key, value in context.items() if key in accepted}
    try:
        return component(**supplied, **values)
    except (ValueError, DeepIRError) as error:
        raise ConfigError(f"{where}: {error}") from error


@functools.cache
def options_schema(component: Any) -> type[BaseModel]:
    """Options that a configuration may set, with types and defaults: the arguments without the context."""
    fields: dict[str, Any] = {
        name: (p.annotation, ... if p.default is p.empty else p.default)
        for name, p in _arguments(component).items()
        if name not in CONTEXT_ARGUMENTS
    }
    return create_model(f"{component.__name__} options", __config__=ConfigDict(extra="forbid"), **fields)


@functools.cache
def _arguments(component: Any) -> dict[str, inspect.Parameter]:
    """What a function or a constructor takes by name; `**options` stands for what the class's base takes."""
    bases = [each for each in component.__mro__ if "__init__" in vars(each)] if inspect.isclass(component) else []
    found: dict[str, inspect.Parameter] = {}
    for call in [vars(each)["__init__"] for each in bases] or [component]:
        hints = typing.get_type_hints(call, include_extras=True)
        taken = inspect.signature(call).parameters.values()
        for each in taken:
            if each.kind in (each.KEYWORD_ONLY, each.POSITIONAL_OR_KEYWORD) and each.name != "self":
                found.setdefault(each.name, each.replace(annotation=hints.get(each.name, Any)))
        if not any(each.kind is each.VAR_KEYWORD for each in taken):
            break
    return found


def validate(schema: type[BaseModel], options: Any, where: str) -> dict[str, Any]:
    """Check options and fill in defaults; `auto` stands for a missing one.

    Raises:
        ConfigError: An option is wrong; the message says what is allowed, with the nearest spelling.
    """
    if not isinstance(options, Mapping):
        raise ConfigError(f"{where} = {options!r}: a mapping of options is needed ({', '.join(schema.model_fields)})")
    given = {key: value for key, value in options.items() if value != "auto"}
    try:
        checked = schema.model_validate(given)
    except ValidationError as error:
        _, problem = explain(error, schema)
        raise ConfigError(f"{where}: {problem}") from None
    return {name: getattr(checked, name) for name in schema.model_fields}


def explain(error: ValidationError, schema: type[BaseModel], whole: Any = None) -> tuple[str, str]:
    """The most likely cause of a validation error.

    Args:
        error: The error of pydantic.
        schema: The schema.
        whole: The configuration, in which an unknown key may belong to a deeper level.

    Returns:
        The path of the key, and one line on the error.
    """
    # A misspelt key explains best; of a union's branches, the one that went deepest is what was meant.
    rank = {"extra_forbidden": 0, "missing": 1}
    worst = min(error.errors(), key=lambda e: (rank.get(e["type"], 2), -len(list(_steps(schema, e["loc"])))))
    steps = list(_steps(schema, worst["loc"]))
    path = ".".join(name for name, _ in steps)
    if worst["type"] == "extra_forbidden":
        inner = [f"{name}.{key}" for name, each in schema.model_fields.items() for key in _keys(each.annotation)]
        if inside := [key for key in (*inner, *dict(nested(whole))) if key.endswith(f".{path}")]:
            return path, f"no option '{path}'; did you mean '{inside[0]}'?"
        allowed = _keys(steps[-2][1] if steps[1:] else schema)
        hint = nearest(steps[-1][0], allowed)
        if (parent := path.rpartition(".")[0]) and not any(step.isdigit() for step in path.split(".")):
            hint = hint.replace("did you mean '", f"did you mean '{parent}.")
        return path, f"no option '{path}'; {hint}"
    if worst["type"] == "missing":
        return path, f"{path} is missing"
    if worst["type"] == "too_short":
        need = "at least one is needed"
    elif worst["type"].startswith(("greater", "less")):
        need = worst["msg"].lower().replace("input should", "it must")
    else:
        need = f"{describe_type(steps[-1][1]) if steps else 'a mapping'} is needed"
    return path, f"{path} = {worst['input']!r}: {need}"


def describe_type(annotation: Any) -> str:
    """A type in words.

    >>> describe_type(int | list[float] | None)
    'a whole number or a list [...] of numbers'
    """
    origin, arguments = typing.get_origin(annotation), typing.get_args(annotation)
    if annotation in TYPE_DESCRIPTIONS:
        return TYPE_DESCRIPTIONS[annotation]
    if origin is Literal:
        return " or ".join(f"'{each}'" for each in arguments)
    if origin in (Union, types.UnionType):
        return " or ".join(describe_type(each) for each in _alternatives(annotation))
    if origin in (list, tuple) and arguments:
        return f"a list [...] of {ELEMENT_DESCRIPTIONS.get(arguments[0], 'mappings')}"
    if names := _keys(annotation):
        return f"a mapping with {', '.join(names)}"
    return "a mapping" if annotation is dict or origin is dict else f"a value of type {annotation}"


def annotation_of(schema: type[BaseModel], path: str) -> Any:
    """Type of a key such as `data.path` in a schema; None if the schema has no such key."""
    steps = list(_steps(schema, tuple(path.split("."))))
    return steps[-1][1] if len(steps) == path.count(".") + 1 else None


def _steps(schema: Any, loc: tuple[int | str, ...]) -> Iterator[tuple[str, Any]]:
    """A path's keys with their types; the names that pydantic gives to a union's branches are left out."""
    for part in loc:
        if len(_alternatives(schema)) > 1 and (part in SCALAR_TYPE_NAMES or str(part).startswith("dict[")):
            return  # pydantic's name of a branch that has no keys of its own
        models = [each for each in _alternatives(schema) if hasattr(each, "model_fields")]
        inner = next((m.model_fields[part].annotation for m in models if part in m.model_fields), None)
        if inner is None and (branch := next((m for m in models if m.__name__ == part), None)):
            schema = branch
            continue
        if inner is None and models and len(_alternatives(schema)) > 1:
            return  # pydantic's name of another branch
        if inner is None and not models:
            lists = [each for each in _alternatives(schema) if typing.get_origin(each) in (list, dict)]
            if not lists or (typing.get_origin(lists[0]) is list) != isinstance(part, int):
                return
            inner = typing.get_args(lists[0])[-1]
        schema = inner
        yield str(part), inner


def _alternatives(annotation: Any) -> tuple[Any, ...]:
    if typing.get_origin(annotation) not in (Union, types.UnionType):
        return (annotation,)
    return tuple(each for each in typing.get_args(annotation) if each is not type(None))


def nested(node: Any, above: str = "") -> Iterator[tuple[str, Any]]:
    """All values of nested mappings, by their keys and those above, such as `data.path`."""
    for key, value in node.items() if isinstance(node, Mapping) else ():
        yield f"{above}{key}", value
        yield from nested(value, f"{above}{key}.")


def _keys(annotation: Any) -> list[str]:
    return [name for each in _alternatives(annotation) for name in getattr(each, "model_fields", ())]
