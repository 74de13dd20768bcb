"""Denoisers for the penalty `red`: `(picture (S, C, H, W), noise) -> picture`. One a file; a new file is found by itself."""
