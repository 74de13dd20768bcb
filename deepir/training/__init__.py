"""Trainings of `deepir train NAME`; the registry finds a new file by itself."""
