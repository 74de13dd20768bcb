"""The drivers of live cameras, on made-up devices: what they ask of them, and what they say where one fails."""

import errno
import sys
from types import SimpleNamespace

import numpy as np
import pytest
import recordings

from deepir.cameras.boson import Boson
from deepir.cameras.v4l2 import V4L2
from deepir.errors import DataError

RAMP = np.arange(3 * 18 * 16, dtype=np.uint16).reshape(3, 18, 16)


@pytest.fixture
def device(tmp_path, monkeypatch):
    """Makes a film stand for a camera: `device(stored)` is its path, what it was opened with is in `device.options`."""
    av = pytest.importorskip("av")
    opened = av.open

    def make(stored="gray16le"):
        frames = RAMP if stored == "gray16le" else RAMP.astype(np.uint8)
        recordings.film(tmp_path / "video0.mkv", frames, stored=stored)

        def open_film(path, format, options, timeout):  # noqa: A002 - PyAV's name
            make.options = options | {"format": format}
            return opened(path)

        monkeypatch.setattr(av, "open", open_film)
        return str(tmp_path / "video0.mkv")

    return make


def test_raw_frames_come_as_they_are(device):
    with V4L2(device=device(), mode=[16, 18]) as camera:
        assert device.options == {"pixel_format": "gray16le", "fflags": "+4", "video_size": "16x18", "format": "v4l2"}
        packets = iter([packet for packet in camera.container.demux(camera.track) if packet.size])

        def demux(_):
            yield from packets
            raise BlockingIOError(errno.EAGAIN, "nothing yet")

        camera.container = SimpleNamespace(demux=demux, close=camera.container.close)
        np.testing.assert_array_equal(camera.read(), RAMP[-1])  # the newest
        assert camera.read() is None


def test_a_camera_that_is_unplugged_is_gone(device):
    camera = V4L2(device=device())

    def unplugged(_):
        raise OSError(errno.ENODEV, "No such device")
        yield

    camera.container = SimpleNamespace(demux=unplugged)
    with pytest.raises(DataError, match="the camera is gone"):
        camera.read()


def test_a_webcam_gives_no_counts(device):
    with pytest.raises(DataError, match=r"gives gray and no raw 16-bit frames \(Y16\)"):
        V4L2(device=device("gray"))


@pytest.mark.parametrize(
    ("number", "said"),
    [
        (errno.ENOENT, "no such camera"),
        (errno.EACCES, "usermod -aG video"),
        (errno.EBUSY, "another program uses it"),
        (errno.EINVAL, "does not give raw 16-bit frames"),
        (errno.EIO, "cannot be opened"),
    ],
)
def test_why_a_device_does_not_open_is_said(monkeypatch, number, said):
    av = pytest.importorskip("av")
    with pytest.raises(DataError, match=r"^/dev/video99: no such camera"):
        V4L2(device="/dev/video99")  # as it is

    def fail(*_, **__):
        raise OSError(number, "no")

    monkeypatch.setattr(av, "open", fail)
    with pytest.raises(DataError, match=said):
        V4L2(device="/dev/video7")


@pytest.fixture
def flirpy(monkeypatch):
    """A Boson as flirpy gives it; its commands are in `flirpy.commands`."""
    module = SimpleNamespace(commands=[], FLR_BOSON_AUTO_FFC=1, connected=True, mode=1)

    def made(port):
        said = module.commands.append
        return SimpleNamespace(
            conn=object() if module.connected else None,
            setup_video=lambda number: said("video"),
            get_camera_serial=lambda: 4711,
            get_ffc_mode=lambda: module.mode,
            set_ffc_manual=lambda: said("manual"),
            set_ffc_auto=lambda: said("auto"),
            grab=lambda: RAMP[0],
            close=lambda: said("close"),
        )

    module.Boson = made
    monkeypatch.setitem(sys.modules, "flirpy.camera.boson", module)
    return module


def test_the_bosons_shutter_is_held_and_let_go(flirpy):
    with Boson() as camera:
        np.testing.assert_array_equal(camera.read(), RAMP[0])
        assert flirpy.commands == ["video", "manual"]
    assert flirpy.commands[2:] == ["auto", "close"]


def test_a_shutter_that_was_held_stays_held(flirpy):
    flirpy.mode = 0
    with Boson():
        pass
    assert flirpy.commands[2:] == ["close"]


def test_no_boson(flirpy):
    flirpy.connected = False
    with pytest.raises(DataError, match="camera 'boson': cannot be opened: it does not answer"):
        Boson()
