"""Registration of bursts under strong fixed-pattern noise; `docs/explanation/motion.md` says why.

1. Frames that say nothing are excluded: repeated ones, those of a closed shutter (`register_burst`).
2. Coarse search on a band-passed level: cross-correlation over all shifts and some rotations; pans are matched along a
   spanning tree (`shift_likelihood`, `frame_selection`).
3. Scene, fixed pattern and motions alternately, by robust Gauss-Newton steps (`alignment`, `motion_search`).
4. Other candidates, scene and pattern integrated out: shifts and rotations of maximum likelihood (`block_likelihood`).
5. Where motions do not explain the frames: the same with moving objects inpainted (`moving_objects`), and the worst
   frames once more (`robust_score`). Then homographies, rest, confidence and messages.

Motions `(N, 3, 3)` are pull homographies in px about the frame's centre. Shapes: `H, W` of the full frame, `h, w` of a
level or of block means, `N` frames, `M` frames that are used.
"""

from deepir.registration.register_burst import Registration, register

__all__ = ["Registration", "register"]
