import os
from pathlib import Path

import numpy as np
import pytest

DATA = Path(os.environ.get("DEEPIR_DATA", Path(__file__).parents[3] / "shared" / "data"))


@pytest.fixture
def data():
    """The folder of real pictures."""
    if not DATA.is_dir():
        pytest.skip(f"no real data in {DATA}; set DEEPIR_DATA")
    return DATA


@pytest.fixture
def burst():
    """Three small frames of 14-bit counts."""
    return np.random.default_rng(0).integers(0, 2**14, (3, 20, 24), dtype=np.uint16)
