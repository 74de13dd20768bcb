"""Formats of pictures: TIFF, PNG, JPEG, videos, and folders of pictures."""
