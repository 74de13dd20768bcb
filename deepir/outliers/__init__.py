"""Samples that do not say what the scene is: defective, cut off, or of something that moves by itself."""
