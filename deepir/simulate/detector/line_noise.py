"""Noise that all pixels of a row, or of a column, of one frame have in common.

The temporal row and column noise of the 3-D noise model (D'Agostino and Webb 1991): a microbolometer array is read row
by row, and the bias of each reading is noisy.
"""

from __future__ import annotations

import numpy as np

from deepir.simulate.settings import Settings


def line_noise(settings: Settings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Of each row, (N, H), and of each column, (N, W), of each frame, in the data's units."""
    sigmas = (settings.row_noise, settings.column_noise)
    rows, columns = (
        settings.range * sigma * rng.standard_normal((settings.n_frames, side))
        for sigma, side in zip(sigmas, settings.shape, strict=True)
    )
    return rows, columns
