"""Point-spread functions. One a file; a new file is found by itself."""
