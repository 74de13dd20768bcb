"""Judging corrections by frames of a moving scene, without a truth."""
