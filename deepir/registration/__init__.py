"""Registration of bursts under strong fixed-pattern noise. `register` is the entry.

The algorithm, with the functions of each step in order:

1. Preprocessing: logarithm, stuck pixels (`preprocess.preprocess`).
2. Frames that say nothing are excluded: repeated ones (`register_burst.repeated_frames`), frames of a closed shutter
   (`frame_selection.shutter_frames`).
3. Coarse search on a band-passed level (`preprocess.build_level`): cross-correlation over all shifts and some rotations
   (`shift_likelihood.correlation_search`); frames that disagree are rejected
   (`frame_selection.largest_consistent_set`, `reject_frames`); pans are matched along a spanning tree
   (`register_pan`).
4. Alignment on the final levels: scene, fixed pattern and motions alternately, by robust Gauss-Newton steps
   (`alignment.align`, `motion_search.align_levels`).
5. Other candidates, scene and pattern integrated out: shifts of maximum likelihood
   (`shift_likelihood.integer_shifts`, `maximise`, `block_likelihood.select_by_blocks`), and rotations
   (`motion_search.refine_rotation`).
6. Moving objects: if motions do not explain the frames well, steps 3 to 5 once more with the objects inpainted and from
   the background alone (`moving_objects.register_beside_moving_objects`); the worst frames are searched again
   (`robust_score.reregister_worst_frames`).
7. Model selection: homographies (`motion_search.select_homography`), rest (`frame_selection.frames_at_rest`).
8. Confidence: concordance with the other frames (`frame_selection.concordance`), and messages
   (`register_burst.make_registration`).

A candidate replaces a motion by one of three rules: the log-likelihood ratio of all blocks but the best
(`block_likelihood.accept_by_blocks`), the trimmed robust log-likelihood ratio of residuals
(`robust_score.accept_by_residuals`), the ratio of misfits (`alignment.accept_by_misfit`; per degree of freedom:
`frame_selection.has_clearly_lower_misfit`).

Motions `(N, 3, 3)` are pull homographies in px about the frame's centre. Shapes: `H, W` of the full frame, `h, w` of a
level or of block means, `N` frames, `M` frames that are used.
"""

from deepir.registration.register_burst import Registration, register

__all__ = ["Registration", "register"]
