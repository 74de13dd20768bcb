"""Gain and offset in closed form, given what falls on the detector."""
