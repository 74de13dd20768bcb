"""Formats of thermal cameras: FLIR, DJI, CPTV."""
