"""Constants that the kernels and their torch twins share."""

#: Entries of a homography are kept below `MAX_ENTRY`, and depths above `MIN_DEPTH`, so that no coordinate overflows.
MAX_ENTRY, MIN_DEPTH = 1e6, 1e-3
