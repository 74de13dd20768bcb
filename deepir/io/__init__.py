"""Files in and out: frames, masks and truths as NumPy arrays, checked before anything is solved."""

from deepir.io.frames import Frames, cropped, fit_truth, read_data, read_frames, read_mask, read_truth, stream_data
from deepir.io.inspection.checks import crop, validate
from deepir.io.inspection.describe import describe
from deepir.io.output import atomic_file, atomic_files, write_json, write_mat, write_npz, write_preview, write_tiff

__all__ = [
    "Frames",
    "atomic_file",
    "atomic_files",
    "crop",
    "cropped",
    "describe",
    "fit_truth",
    "read_data",
    "read_frames",
    "read_mask",
    "read_truth",
    "stream_data",
    "validate",
    "write_json",
    "write_mat",
    "write_npz",
    "write_preview",
    "write_tiff",
]
