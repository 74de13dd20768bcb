"""Which method a configuration chooses, with its options: a method's signature is its schema."""

from __future__ import annotations

import functools
import inspect
from collections.abc import Callable
from typing import Any

from deepir.config import Config
from deepir.config.components import options_schema, validate
from deepir.registry import lookup
from deepir.result import Result


def chosen(config: Config) -> tuple[str, Callable[..., Result]]:
    """The name of `config.method`, and the method with its options.

    What is returned is called as `method(burst, config, callbacks=..., checkpoint=...)`; a method that has no use for
    the last two need not take them.

    Raises:
        ConfigError: No method has this name, or it does not take these options.
    """
    given = config.method if isinstance(config.method, dict) else {"type": config.method}
    name = str(given.get("type", "joint"))
    method = lookup("method", name, "method")
    options = {key: value for key, value in given.items() if key != "type"}
    values = validate(options_schema(method), options, f"method '{name}'")
    takes = inspect.signature(method).parameters

    @functools.wraps(method)
    def run(*data: Any, **context: Any) -> Result:
        result: Result = method(*data, **{k: v for k, v in context.items() if k in takes}, **values)
        return result

    return name, run
