"""Errors of a result against the truth of its burst."""

from __future__ import annotations

import math

import numpy as np
import torch

from deepir.burst import Burst
from deepir.messages import Message
from deepir.metrics import motion_error, scores
from deepir.operators.geometry import rescale_motion
from deepir.result import Result


def compare_to_truth(result: Result, burst: Burst) -> dict[str, float | None]:
    """Scores of the scene and errors of gain, offset, stray flux and motion, as far as the truth has them.

    Returns:
        Root mean square errors by name: of maps over good pixels, in the data's units; of the motion in px of a frame.
        With a radiometry, `radiometric_rmse_mk` is the scene's error without its mean, mK. Empty, with a message of the
        result, if the scene's shape differs from the truth's.
    """
    truth = burst.truth
    if "scene" not in truth:
        return {}
    if truth["scene"].shape != result.scene.shape:
        result.messages.append(
            Message(
                "truth-not-compared",
                f"data.truth: the scene is {truth['scene'].shape}, the result {result.scene.shape}: not compared",
            )
        )
        return {}
    bound = result.extra.get("clipped", np.zeros((), np.int8)) != 0  # of which the frames do not show more
    known = np.where(bound, np.nan, truth["scene"])
    found: dict[str, float | None] = {k: float(v) for k, v in scores(result.scene, known).items()}
    if burst.radiometry is not None:
        kelvin = [burst.radiometry.kelvin(each).astype(float) for each in (result.scene, known)]
        found["radiometric_rmse_mk"] = 1000 * float(np.nanstd(kelvin[0] - kelvin[1]))
    maps = {"gain": result.gain, "offset": result.offset, "stray": result.extra.get("stray")}
    for name, array in maps.items():
        if array is not None and name in truth and truth[name].shape == array.shape:
            off = (array - truth[name])[~result.bad_pixels]
            found[f"{name}_rmse"] = float(np.sqrt(np.mean(off.astype(float) ** 2)))
    if "motion" in truth and truth["motion"].shape == result.motion.shape:
        ratio = result.scene.shape[-1] / burst.size[1]
        motion = rescale_motion(torch.from_numpy(result.motion), 1 / ratio).numpy()
        error = motion_error(motion, truth["motion"], burst.size)
        found["motion_rmse"] = None if math.isnan(error) else error
    return found
