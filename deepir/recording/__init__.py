"""Correction of whole recordings: one camera, many scenes."""
