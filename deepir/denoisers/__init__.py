"""Denoisers for the penalty `red`, `(picture (S, C, H, W), noise) -> picture`; a new file is found by itself."""
