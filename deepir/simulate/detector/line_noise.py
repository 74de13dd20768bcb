"""Noise that all pixels of a row, or of a column, of one frame share.

A microbolometer array is read row by row, and the bias of each reading is noisy.

Source: the temporal row and column noise of the 3-D noise model, D'Agostino and Webb (1991).
"""

from __future__ import annotations

import numpy as np

from deepir.simulate.settings import Settings


def line_noise(settings: Settings, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Row noise (N, H) and column noise (N, W) of each frame, in the data's units."""
    sigmas = (settings.row_noise, settings.column_noise)
    rows, columns = (
        settings.range * sigma * rng.standard_normal((settings.n_frames, side))
        for sigma, side in zip(sigmas, settings.shape, strict=True)
    )
    return rows, columns
