"""Networks whose output is the scene. A new file is found by itself."""
