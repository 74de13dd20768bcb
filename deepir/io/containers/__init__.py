"""Containers that several formats share: FFF records, JPEG segments, named arrays."""
