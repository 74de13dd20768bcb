"""A result at the prompt."""

import numpy as np

from deepir.result import Result


def test_a_result_says_what_it_is_in_a_few_lines():
    maps = {name: np.ones((6, 8)) for name in ("scene", "gain", "offset")}
    used = np.array([True, False, True])
    result = Result(
        **maps,
        motion=np.tile(np.eye(3), (3, 1, 1)),
        level=np.zeros(3),
        bad_pixels=np.eye(6, 8) > 0,
        frames_used=used,
        history=[{"loss": 1.0}] * 100,
        messages=["frame 1 does not register"],
    )
    assert repr(result) == (
        "Result: scene 6 x 8 of 2 frames, gain σ 0, offset σ 0, 6 bad pixels\n- frame 1 does not register"
    )
    assert result != Result(**maps, motion=result.motion, level=used, bad_pixels=used, frames_used=used)
