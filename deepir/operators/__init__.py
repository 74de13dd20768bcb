"""Operators: pure functions with named slots. One a file; a new file is found by itself.

`from deepir import operators as op`: `op.Blur`, and every other one that is registered; `op.stack` and
`op.identity` of linear maps.
"""

from typing import Any

from deepir.operators.add import Add
from deepir.operators.base import Chain, Operator, Shape
from deepir.operators.blur import Blur
from deepir.operators.downsample import Downsample
from deepir.operators.lag import Lag
from deepir.operators.linear import Linear, identity, stack
from deepir.operators.sensor import Sensor
from deepir.operators.warp import Warp, rescale_motion
from deepir.registry import class_named, classes

__all__ = [
    "Add",
    "Blur",
    "Chain",
    "Downsample",
    "Lag",
    "Linear",
    "Operator",
    "Sensor",
    "Shape",
    "Warp",
    "identity",
    "rescale_motion",
    "stack",
]


def __getattr__(name: str) -> Any:
    return class_named(name, __name__, "operator")


def __dir__() -> list[str]:
    return sorted({*__all__, *classes("operator")})
