"""Registration of bursts under strong fixed-pattern noise.

`register` is the one entry. The files, in the order in which the work is done: `flatten` (logarithm, stripes,
stuck pixels), `pyramid` (band-passed levels), `coarse` (correlation and rotation search), `refine`
(Gauss-Newton), `burst` (the scene and the fixed pattern of the whole burst), `motion` (the motion models).
"""

from deepir.registration.burst import Registration, register

__all__ = ["Registration", "register"]
