"""What is believed of an unknown: fields, which draw it, and penalties, which prefer some values to others.

`from deepir import priors as pr`: `pr.Pixels`, `pr.Siren`, `pr.TV`, and every other one that is registered.
"""

from typing import Any

from deepir.fields.sensor_maps import SumField
from deepir.registry import class_named, classes

__all__ = ["SumField"]


def __getattr__(name: str) -> Any:
    return class_named(name, __name__, "field", "penalty")


def __dir__() -> list[str]:
    return sorted({*__all__, *classes("field", "penalty")})
