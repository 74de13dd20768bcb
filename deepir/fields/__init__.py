"""Fields: how unknowns are represented. A new file is found by itself."""
