"""Operators: pure functions with named slots. One a file; a new file is found by itself."""

from deepir.operators.add import Add
from deepir.operators.base import Chain, Operator, Shape
from deepir.operators.blur import Blur
from deepir.operators.downsample import Downsample
from deepir.operators.lag import Lag
from deepir.operators.sensor import Sensor
from deepir.operators.warp import Warp

__all__ = ["Add", "Blur", "Chain", "Downsample", "Lag", "Operator", "Sensor", "Shape", "Warp"]
