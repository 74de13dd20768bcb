"""Priors of the scene: networks, and penalties."""
