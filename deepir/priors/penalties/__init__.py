"""Penalties: what is preferred of a value. One a file; a new file is found by itself."""
