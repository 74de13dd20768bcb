"""Networks whose output is the scene. One a file; a new file is found by itself."""
