"""Counts to kelvin."""

import dataclasses

import numpy as np
import pytest
import recordings
from hypothesis import given
from hypothesis import strategies as st

from deepir.config.schema import Radiometry as Asked
from deepir.errors import ConfigError
from deepir.io import read_frames, write_tiff
from deepir.io.radiometry import KELVIN, Linear, Planck, air_transmission, resolve_radiometry, unit_metadata
from deepir.io.readers import flir

T640 = Planck(16556.0, 1428.0, 1.0, -342.0, 0.0451)


def test_tlinear_is_a_hundredth_of_a_kelvin_a_count():
    np.testing.assert_allclose(Linear(0.01).kelvin(np.array([27315, 29315], np.uint16)), [273.15, 293.15])


def test_degrees_celsius_are_shifted():
    assert Linear(1.0, 273.15).kelvin(np.array([-3.15]))[0] == pytest.approx(270.0)


def test_the_papers_lepton_has_its_constants():
    """Counts = R / (exp(B / T) - F) + O with R 82589, B 641, F 1, O 18955 (Saragadam et al. 2021)."""
    kelvin = np.array([250.0, 293.15, 320.0])
    counts = 82589 / (np.exp(641 / kelvin) - 1) + 18955
    np.testing.assert_allclose(Planck(82589, 641, 1, -18955).kelvin(counts), kelvin, rtol=1e-6)


@given(
    st.floats(230, 500),
    st.floats(0.3, 1),
    st.floats(0.5, 1),
    st.floats(0.5, 1),
    st.lists(st.floats(250, 330), min_size=3, max_size=3),
)
def test_what_the_camera_sees_through_air_and_window_comes_back(kelvin, emissivity, through, glass, others):
    def body(t):
        return 16556 / (0.0451 * (np.exp(1428 / t) - 1)) + 342

    reflected, atmosphere, window = others
    at_lens = emissivity * body(kelvin) + (1 - emissivity) * body(reflected)
    at_window = through * at_lens + (1 - through) * body(atmosphere)
    counts = glass * at_window + (1 - glass) * body(window)
    law = dataclasses.replace(
        T640,
        emissivity=emissivity,
        reflected=reflected,
        transmission=through,
        atmosphere=atmosphere,
        window_transmission=glass,
        window=window,
    )
    assert law.kelvin(np.array([counts]))[0] == pytest.approx(kelvin, abs=0.01)


def test_counts_below_any_temperature_have_none():
    assert np.isnan(T640.kelvin(np.array([100.0, 342.0]))).all()


def test_air_takes_more_the_farther_and_the_wetter():
    def through(distance, humidity):
        return air_transmission(distance, humidity, 293.15, (0.006569, 0.01262), (-0.002276, -0.00667), 1.9)

    assert through(0, 0.5) == pytest.approx(1)
    assert 1 > through(1, 0.5) > through(10, 0.5) > through(10, 0.9) > 0.8


@pytest.mark.parametrize("write", [recordings.flir_jpeg, recordings.seq])
def test_flirs_files_say_all_of_it(tmp_path, burst, write):
    write(tmp_path / "a", burst)
    law = read_frames(tmp_path / "a").radiometry
    constants = {**recordings.PLANCK, **recordings.WINDOW}
    for name in ("emissivity", "reflected", "atmosphere"):
        constants[name] = recordings.SCENE[name]
    for name, value in constants.items():
        assert getattr(law, name) == pytest.approx(value, rel=1e-6), name
    assert 0.98 < law.transmission < 1


def test_a_file_without_the_cameras_record_says_nothing(tmp_path, burst):
    (tmp_path / "a.seq").write_bytes(recordings.fff(burst[0], camera=False))
    assert read_frames(tmp_path / "a.seq").radiometry is None


@pytest.mark.parametrize(
    ("name", "counts", "mean"),
    [
        ("aqua_tower", 12614.372716049384, 263.58693),
        ("example", 13107.4361328125, 302.19534),
        ("moving_car", 15031.2069140625, 277.42092),
    ],
)
def test_real_pictures_have_the_counts_and_temperatures_that_flyr_finds(data, name, counts, mean):
    """Means by flyr 5.1.0, of temperatures at a distance of zero: its model of the air is another one."""
    read = read_frames(data / "radiometric_jpg" / f"flir_{name}_cc0.jpg")
    assert read.frames.mean(dtype=np.float64) == pytest.approx(counts, rel=1e-9)
    without_air = dataclasses.replace(read.radiometry, transmission=1.0)
    assert without_air.kelvin(read.frames).mean(dtype=np.float64) == pytest.approx(mean, abs=1e-4)
    assert read.radiometry.kelvin(read.frames).mean() == pytest.approx(mean, abs=0.5)


@pytest.mark.parametrize("law", [KELVIN, Linear(0.04, 3.0), T640])
def test_a_tiff_says_what_its_values_are(tmp_path, burst, law):
    write_tiff(tmp_path / "a.tif", burst, unit_metadata(law))
    assert read_frames(tmp_path / "a.tif").radiometry == law


@pytest.mark.parametrize("said", [{}, {"unit": "counts"}, {"radiometry": {"scale": "x"}}, {"radiometry": {"a": 1}}])
def test_anybody_elses_description_says_nothing(tmp_path, burst, said):
    write_tiff(tmp_path / "a.tif", burst, said)
    assert read_frames(tmp_path / "a.tif").radiometry is None


def test_the_user_has_the_last_word():
    assert resolve_radiometry(T640, Asked()) == T640
    assert resolve_radiometry(T640, Asked(emissivity=0.9)) == dataclasses.replace(T640, emissivity=0.9)
    assert resolve_radiometry(T640, Asked(scale=0.01)) == Linear(0.01)
    assert resolve_radiometry(Linear(0.01), Asked(zero=1.0)) == Linear(0.01, 1.0)
    assert resolve_radiometry(None, Asked()) is None


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"scale": 0.01, "emissivity": 0.9}, "scale and emissivity exclude each other"),
        ({"emissivity": 0.9}, "emissivity needs r1 and b too"),
        ({"zero": 3.0}, "zero needs scale too"),
    ],
)
def test_half_a_law_is_refused(given, message):
    with pytest.raises(ConfigError, match=message):
        resolve_radiometry(None, Asked(**given))


@pytest.mark.parametrize(
    ("unit", "zero"),
    [
        *((unit, 250.0) for unit in ("K", "kelvin")),
        *((unit, -23.15) for unit in ("degC", "degrees_celsius", "°C", "Celsius", "deg C")),
        ("counts", None),
    ],
)
def test_scale_and_offset_of_the_cf_conventions_are_those_of_one_array(tmp_path, burst, unit, zero):
    h5py = pytest.importorskip("h5py")
    with h5py.File(tmp_path / "a.nc", "w") as file:
        file["frames"] = burst
        about = {"scale_factor": 0.01, "units": unit, "add_offset": zero or 0.0}
        file.create_dataset("heat", data=burst).attrs.update(about)
    law = read_frames(tmp_path / "a.nc", key="heat").radiometry
    assert (law is None) == (zero is None)
    if law is not None:
        np.testing.assert_allclose(law.kelvin(burst), 0.01 * burst + 250, atol=1e-4)
    assert read_frames(tmp_path / "a.nc", key="frames").radiometry is None


HEAT = np.random.default_rng(0).uniform(285, 300, (20, 24)).astype(np.float32)
CHANGES = [
    {"PLANCK": {"r1": 14000.0, "o": -9000}},
    {"SCENE": {"emissivity": 0.6}},
    {"SCENE": {"reflected": 270.0, "distance": 200.0}},
]


def counted(monkeypatch, **changes):
    """FLIR's FFF of the temperatures HEAT, as a camera with other constants and settings counts them."""
    for name, values in changes.items():
        monkeypatch.setattr(recordings, name, getattr(recordings, name) | values)
    law = flir.read_radiometry(flir.read_records(recordings.fff(np.zeros((20, 24))), "a")[0])
    content = recordings.fff(np.rint(law.counts(HEAT)))
    monkeypatch.undo()
    return content


@pytest.mark.parametrize("law", [Linear(0.04, 10.0), dataclasses.replace(T640, emissivity=0.7)])
def test_counts_are_the_inverse_of_kelvin(law):
    np.testing.assert_allclose(law.kelvin(law.counts(HEAT)), HEAT, atol=0.01)


@pytest.mark.parametrize("changes", CHANGES)
def test_each_frame_of_a_recording_has_its_own_constants(tmp_path, monkeypatch, caplog, changes):
    (tmp_path / "a.seq").write_bytes(counted(monkeypatch) + counted(monkeypatch, **changes))
    read = read_frames(tmp_path / "a.seq")
    assert "what makes kelvin of counts changes, at frame 1 first" in caplog.text
    for frames in (read.frames, np.stack(list(recordings.stream_frames(tmp_path / "a.seq")))):
        np.testing.assert_allclose(read.radiometry.kelvin(frames), np.stack([HEAT, HEAT]), atol=0.1)


def test_each_picture_of_a_folder_has_its_own_constants(tmp_path, monkeypatch):
    for number, changes in enumerate(({}, *CHANGES)):
        content = counted(monkeypatch, **changes)
        marked = [b"FLIR\0\1\0\0" + content]
        (tmp_path / f"{number}.jpg").write_bytes(recordings.jpeg_with(0xE1, marked, (20, 24)))
    read = read_frames(tmp_path)
    np.testing.assert_allclose(read.radiometry.kelvin(read.frames), np.stack([HEAT] * 4), atol=0.1)


def test_what_the_user_says_of_the_scene_holds_for_all_frames(tmp_path, monkeypatch):
    (tmp_path / "a.seq").write_bytes(counted(monkeypatch) + counted(monkeypatch, SCENE={"emissivity": 0.6}))
    asked = Asked(emissivity=0.9)
    plain = read_frames(tmp_path / "a.seq", radiometry=Asked(scale=0.01)).frames
    np.testing.assert_array_equal(read_frames(tmp_path / "a.seq", radiometry=asked).frames, plain)


def test_constants_that_stay_leave_the_counts_as_they_are(tmp_path, burst):
    recordings.seq(tmp_path / "a.seq", burst)
    assert {frame.dtype for frame in recordings.stream_frames(tmp_path / "a.seq")} == {np.dtype(np.uint16)}
