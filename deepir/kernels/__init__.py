"""Loops over samples for the CPU, compiled by numba on first use and kept in its cache.

Import its modules where they are first needed: numba takes 0.2 s. A loop is `loop(first, last, ...)`, for
`compile.parallel_for`. It writes to no element that another part of the range writes to, so that the result does not
depend on the number of threads.
"""
