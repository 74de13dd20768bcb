import sys

import numpy as np
import pytest
import recordings

from deepir.errors import DataError
from deepir.io import read_frames, stream_frames

h5py = pytest.importorskip("h5py")


def test_the_only_recording_needs_no_key_wherever_it_lies(tmp_path, burst):
    recordings.hdf5(tmp_path / "a.h5", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.h5").frames, burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.h5", key="camera/frames").frames, burst)


def test_several_recordings_are_listed_with_their_paths(tmp_path, burst):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["day/one"], file["day/two"] = burst, burst[0]
    with pytest.raises(DataError, match=r"Arrays: day/one \(3, 20, 24\), day/two \(20, 24\)"):
        read_frames(tmp_path / "a.h5")


def test_matlab_73_is_turned_round(tmp_path, burst):
    recordings.mat73(tmp_path / "a.mat", burst)
    np.testing.assert_array_equal(read_frames(tmp_path / "a.mat").frames, burst)


def test_other_files_are_never_opened(tmp_path, burst):
    recordings.hdf5(tmp_path / "other.h5", burst)
    with h5py.File(tmp_path / "link.h5", "w") as file:
        file["frames"] = h5py.ExternalLink("other.h5", "camera/frames")
    with pytest.raises(DataError, match="Arrays: none"):
        read_frames(tmp_path / "link.h5")
    layout = h5py.VirtualLayout(burst.shape, "u2")
    layout[:] = h5py.VirtualSource("other.h5", "camera/frames", burst.shape)
    with h5py.File(tmp_path / "virtual.h5", "w") as file:
        file.create_virtual_dataset("frames", layout)
    with pytest.raises(DataError, match="in other files, which are never opened"):
        read_frames(tmp_path / "virtual.h5")
    (tmp_path / "raw").write_bytes(burst.tobytes())
    with h5py.File(tmp_path / "external.h5", "w") as file:
        file.create_dataset("frames", burst.shape, "u2", external=str(tmp_path / "raw"))
    with pytest.raises(DataError, match="in other files, which are never opened"):
        read_frames(tmp_path / "external.h5")


def test_folders_that_hold_themselves_end(tmp_path, burst):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["frames"] = burst
        file["again"] = file["/"]
    with pytest.raises(DataError, match="more arrays or folders"):
        read_frames(tmp_path / "a.h5")


def test_a_huge_array_without_values_is_refused_at_once(tmp_path):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file.create_dataset("frames", (10**6, 1000, 1000), "f4", chunks=(1, 100, 100))
    with pytest.raises(DataError, match="declares 4,000,000,000,000 bytes"):
        read_frames(tmp_path / "a.h5")


def test_without_the_library_the_extra_is_named(tmp_path, burst, monkeypatch):
    recordings.hdf5(tmp_path / "a.h5", burst)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(DataError, match=r"a\.h5: this needs h5py.*pip install 'deepir\[hdf5\]'"):
        read_frames(tmp_path / "a.h5")


@pytest.mark.parametrize(("unit", "zero"), [("K", 250.0), ("degC", -23.15), ("counts", None)])
def test_scale_offset_and_fill_value_of_the_cf_conventions_are_taken(tmp_path, burst, unit, zero):
    frames = burst.astype(np.int16)
    frames[0, :3] = -32768
    with h5py.File(tmp_path / "a.nc", "w") as file:
        data = file.create_dataset("brightness", data=frames)
        data.attrs.update({"_FillValue": np.int16(-32768), "scale_factor": 0.01, "units": unit})
        data.attrs["add_offset"] = zero or 0.0
    found = read_frames(tmp_path / "a.nc")
    assert np.array_equal(np.isnan(found.frames), frames == -32768)
    assert [np.ma.count_masked(each) for each in stream_frames(tmp_path / "a.nc")] == [72, 0, 0]
    if zero is None:
        assert found.radiometry is None
    else:
        np.testing.assert_allclose(found.radiometry.kelvin(frames[1]), 0.01 * frames[1] + 250, atol=1e-4)


def test_a_dataset_for_each_frame_is_named(tmp_path, burst):
    with h5py.File(tmp_path / "a.h5", "w") as file:
        for number, frame in enumerate(burst):
            file[f"frame{number:03}"] = frame
    with pytest.raises(DataError, match="look like a frame each: join them"):
        read_frames(tmp_path / "a.h5")


@pytest.mark.parametrize(
    "attributes",
    [
        {"missing_value": np.array([-1, -2], np.int16)},
        {"valid_range": np.array([0, 32000], np.int16)},
        {"valid_min": np.int16(0)},
    ],
)
def test_other_names_of_lost_samples_are_known(tmp_path, burst, attributes):
    frames = burst.astype(np.int16)
    frames[0, :2], frames[1, :2] = -1, -2
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("brightness", data=frames).attrs.update(attributes)
    np.testing.assert_array_equal(np.isnan(read_frames(tmp_path / "a.nc").frames), frames < 0)


@pytest.mark.parametrize("unit", ["K", "kelvin", "degrees_celsius", "°C", "Celsius", "deg C"])
def test_units_have_many_names_and_belong_to_one_array(tmp_path, burst, unit):
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["frames"] = burst
        file.create_dataset("heat", data=burst).attrs["units"] = unit
    law = read_frames(tmp_path / "a.nc", key="heat").radiometry
    assert law.zero == (0 if unit.lower().startswith("k") else 273.15)
    assert read_frames(tmp_path / "a.nc", key="frames").radiometry is None


def test_unsigned_counts_of_netcdf_are_unsigned(tmp_path, burst):
    frames = burst + np.uint16(25000)
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file.create_dataset("frames", data=frames.view(np.int16)).attrs["_Unsigned"] = "true"
    np.testing.assert_array_equal(read_frames(tmp_path / "a.nc").frames, frames)
