"""Imperfections of a camera or a burst; a new file is found by itself."""
