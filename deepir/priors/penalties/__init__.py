"""Penalties: what is preferred of a value. A new file is found by itself."""
