"""Array helpers that know no problem: statistics, windows, filling."""

from typing import Any

import numpy as np

Array = np.ndarray[Any, Any]  # of NumPy, of any shape and type
