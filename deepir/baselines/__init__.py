"""Classical and learned methods to compare with.

They are grouped by what they need: `single_frame`, `temporal` (frames compared pixel by pixel), `registered`. Each
file holds one method; the registry finds a new file by itself.
"""
