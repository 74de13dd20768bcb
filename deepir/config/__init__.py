"""Configurations: read, merged and checked before anything runs."""

from deepir.config.files import SHIPPED_CONFIGS, dump, find, headline, load, prior_names, read, shipped_names
from deepir.config.schema import Config, Data

__all__ = [
    "SHIPPED_CONFIGS",
    "Config",
    "Data",
    "dump",
    "find",
    "headline",
    "load",
    "prior_names",
    "read",
    "shipped_names",
]
