"""Correction of frames as they come, with an estimate that improves beside them."""
