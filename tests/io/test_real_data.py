"""Every file of real cameras that is at hand opens, and is described."""

import hashlib

import pytest
from typer.testing import CliRunner

from deepir.cli import app
from deepir.io import read_frames

FILES = {
    "a65/a65_frames_000-009.npz": ((10, 512, 640), "uint16"),
    "a65/a65_frames_010-069.npz": ((60, 512, 640), "uint16"),
    "deepir_test/test1.png": ((1, 512, 640), "uint8"),
    "deepir_test/test2.png": ((1, 512, 640), "uint8"),
    "dji_h30t/H30T_DJI_0001_R_1280x1024_u16.npz": ((1, 1024, 1280), "uint16"),
    "dji_h30t/H30T_DJI_0002_R_1280x1024_u16.npz": ((1, 1024, 1280), "uint16"),
    "dji_h30t/H30T_DJI_0003_R_1280x1024_u16.npz": ((1, 1024, 1280), "uint16"),
    "lepton/lepton_tlinear_82x120x160.npz": ((82, 120, 160), "uint16"),
    "lepton/v2.cptv": ((100, 120, 160), "uint16"),
    "lynred_car/calibrated.avi": ((600, 480, 640), "uint8"),
    "lynred_car/raw.avi": ((600, 480, 640), "uint8"),
    "radiometric_jpg/duo_pro_r_radiometric.tiff": ((1, 512, 640), "uint16"),
    "radiometric_jpg/flir_aqua_tower_cc0.jpg": ((1, 180, 180), "uint16"),
    "radiometric_jpg/flir_example_cc0.jpg": ((1, 320, 240), "uint16"),
    "radiometric_jpg/flir_moving_car_cc0.jpg": ((1, 240, 320), "uint16"),
    "seek/seek_face.mat": ((1, 156, 208), "float32"),
    "seek/seek_floor.mat": ((1, 156, 208), "float32"),
    "tensoristd/easy4.npz": ((100, 240, 320), "uint8"),
    "tensoristd/sequence1.npz": ((100, 256, 256), "uint8"),
    "tensoristd/sequence5.npz": ((100, 256, 256), "uint8"),
    "tensoristd/sequence8.npz": ((100, 256, 256), "uint8"),
    "tensoristd/sequence9.npz": ((100, 256, 256), "uint8"),
}


def test_no_file_is_forgotten(data):
    there = {str(path.relative_to(data)) for path in data.glob("*/*") if path.is_file() and path.suffix != ".md"}
    assert there <= set(FILES)


#: Like another one.
SLOW = {
    "a65/a65_frames_010-069.npz", "deepir_test/test2.png", "dji_h30t/H30T_DJI_0002_R_1280x1024_u16.npz",
    "dji_h30t/H30T_DJI_0003_R_1280x1024_u16.npz", "lynred_car/calibrated.avi", "seek/seek_floor.mat",
    "tensoristd/sequence5.npz", "tensoristd/sequence8.npz", "tensoristd/sequence9.npz",
}  # fmt: skip


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name in SLOW else name for name in FILES]
)
def test_real_files_are_read_and_described(data, name):
    if not (data / name).exists():
        pytest.skip(f"{data / name} is absent")
    (count, height, width), dtype = FILES[name]
    checked = CliRunner().invoke(app, ["check", str(data / name)])
    assert checked.exit_code == 0
    assert f"{count} frame(s) of {height} x {width} px (height x width), stored as {dtype}" in checked.output
    assert "values " in checked.output


def test_a_recording_in_cptv_is_what_the_projects_own_reader_finds(data):
    """SHA-256 of the frames as cptv 1.5.5 reads them."""
    frames = read_frames(data / "lepton" / "v2.cptv").frames.astype("<u2")
    assert hashlib.sha256(frames.tobytes()).hexdigest() == (
        "61a3d885b645142be914512877d5814d920fec91edfc843c3cbe37bdfda7f4d1"
    )


def test_a_camera_of_a_trap_that_stands_still_is_refused(data, tmp_path):
    found = CliRunner().invoke(app, ["correct", str(data / "lepton" / "v2.cptv"), "--output", str(tmp_path / "a.tif")])
    assert "stands still" in str(found.exception)
