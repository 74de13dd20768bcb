"""Imperfections of a camera or a burst. One a file; a new file is found by itself."""
