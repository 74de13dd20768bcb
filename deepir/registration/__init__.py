"""Registration of bursts under strong fixed-pattern noise.

`register` in `burst` is the one entry. The other files, in the order in which the work is done: `flatten` (logarithm,
stuck pixels), `place` (where frames are, from first to last), `pyramid` (band-passed levels), `group` (which frames
show one scene), `search` (correlation over all shifts and some rotations), `align` (scene, fixed pattern and motions,
alternately), `pull` (frames on the grid of the first), `refine` (a Gauss-Newton step), `vote` (residuals or
likelihood), `even` (a pattern as strong in the bright as in the dark), `whole` (shifts in whole px, all of them at
once), `likelihood` (of shifts), `parts` (of turns, by parts that shift), `walker` and `beside` (once more without
somebody who walks by), `bend` (frames that bend), `motion` (the motion models).
"""

from deepir.registration.register_burst import Registration, register

__all__ = ["Registration", "register"]
