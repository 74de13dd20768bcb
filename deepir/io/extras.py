"""Libraries that only some formats need."""

from __future__ import annotations

import importlib
from typing import Any

from deepir.errors import DataError


def import_optional(library: str, extra: str, what: str) -> Any:
    """The module `library`; `DataError` that names deepir's `extra` where it is not installed."""
    try:
        return importlib.import_module(library)
    except ImportError:
        raise DataError(
            f"{what}: this needs {library}, which is not installed: pip install 'deepir[{extra}]'"
        ) from None
