"""Point-spread functions. A new file is found by itself."""
