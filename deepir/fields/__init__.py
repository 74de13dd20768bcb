"""Fields: how unknowns are represented. One a file; a new file is found by itself."""
