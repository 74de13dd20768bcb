"""Constants that the kernels and their torch twins share."""

#: Largest entry of a homography: beyond, coordinates overflow in float32.
MAX_ENTRY = 1e6
#: Smallest depth of a projected point.
MIN_DEPTH = 1e-3
#: Determinants that are multiplied before one logarithm is taken.
DETERMINANTS_PER_LOG = 8
