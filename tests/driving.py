"""Frames of a camera that drives forward: each is 3 % larger than the one before."""

import numpy as np
from scipy import ndimage

SIZE = (120, 160)


def drive(picture, count):
    """Frames (count, 120, 160) of the middle of a picture."""
    middle = (np.array(picture.shape) - 1) / 2
    y, x = (np.arange(side) - (side - 1) / 2 for side in SIZE)
    places = [np.meshgrid(middle[0] + y / 1.03**k, middle[1] + x / 1.03**k, indexing="ij") for k in range(count)]
    return np.stack([ndimage.map_coordinates(picture, each, order=3) for each in places])
