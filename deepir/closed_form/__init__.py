"""Gain and offset in closed form, given the flux on the detector."""
