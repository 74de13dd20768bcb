"""Trainings of `deepir train NAME`: one a file; the registry finds a new file by itself."""
