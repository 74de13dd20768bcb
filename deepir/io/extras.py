"""Libraries that only some formats need."""

from __future__ import annotations

import importlib
from typing import Any

from deepir.errors import DataError


def import_optional(library: str, extra: str, what: str) -> Any:
    """Import a library that only some formats need.

    Args:
        library: Name of the module.
        extra: Extra of deepir that installs it.
        what: File or option that needs it, for the message.

    Returns:
        The module.

    Raises:
        DataError: It is not installed; the message names the extra.
    """
    try:
        return importlib.import_module(library)
    except ImportError:
        raise DataError(
            f"{what}: this needs {library}, which is not installed: pip install 'deepir[{extra}]'"
        ) from None
