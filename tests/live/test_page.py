"""The server of the page: who may look, what a viewer gets, and what a slow or a hostile one cannot do."""

import http.client
import io
import re
import socket
import struct
import time
from urllib.parse import urlsplit

import numpy as np
import pytest
import tifffile
from PIL import Image
from websockets.exceptions import ConnectionClosed, InvalidStatus

from deepir.io.radiometry import Linear
from deepir.io.tone_mapping import apply_palette, percentile
from deepir.live.page import views
from deepir.live.page.server import serve
from deepir.live.sources import play


def get(address, path="", **headers):
    """Status, headers and content of an answer."""
    parts = urlsplit(address)
    connection = http.client.HTTPConnection(parts.hostname, parts.port, timeout=10)
    connection.request("GET", parts.path + path, headers={"Host": parts.netloc} | headers)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return answer.status, answer.headers, content


@pytest.fixture
def made(monkeypatch):
    """The frames that were made into pictures."""
    frames, jpeg = [], views.jpeg
    monkeypatch.setattr(views, "jpeg", lambda frame, *chosen: frames.append(frame) or jpeg(frame, *chosen))
    return frames


def test_the_page_loads_only_files_that_are_there(address):
    status, headers, page = get(address)
    assert status == 200
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    named = re.findall(r'(?:src|href)="([^"]+)"', page.decode())
    assert {"live.css", "live.js", "page.js"} <= set(named)
    for name in set(named) - {"snapshot.tif", "snapshot.png"}:
        status, headers, content = get(address, name)
        assert (status, bool(content), headers["X-Content-Type-Options"]) == (200, True, "nosniff"), name
    assert get(address, "../server.py")[0] == 404


def test_a_title_cannot_end_the_element_it_stands_in(live, address):
    live.session.title = "</script><script>alert(1)</script>"
    assert b"<script>alert" not in get(address)[2]


@pytest.mark.parametrize(
    ("status", "hosts"),
    [
        (403, ["evil.example", "127.0.0.1.evil.example", "", "[::1"]),
        (200, ["localhost", "[::1]:8265", "192.168.1.5:9000"]),
    ],
)
def test_a_foreign_host_name_is_refused_and_an_address_is_not(address, status, hosts):
    assert [get(address, Host=host)[0] for host in hosts] == [status] * len(hosts)


def test_a_foreign_origin_is_refused_and_its_own_may_look(live, address, viewer):
    live.show()
    for origin in ("http://evil.example", "null", "http://127.0.0.1:1"):
        assert get(address, "snapshot.tif", Origin=origin)[0] == 403
        with pytest.raises(InvalidStatus, match="403"):
            viewer(origin=origin)
    assert viewer(origin=address.rstrip("/")).ask()[1]["number"] == 1


def test_where_others_reach_the_server_its_address_holds_a_token(live, viewer):
    live.show()
    with serve(live.session, "0.0.0.0", 0) as whole:
        port, token = re.fullmatch(r"http://[\d.]+:(\d+)/([\w-]{20,})/", whole).groups()
        bare = f"http://127.0.0.1:{port}/"
        assert get(f"{bare}{token}/", "live.js")[0] == 200
        assert viewer(f"{bare}{token}/").ask()[1]["number"] == 1
        for wrong in ("", "live.js", f"{token[:-1]}/", f"{token}x/", "snapshot.tif", "t%C3%B6ken/"):
            assert get(bare, wrong)[0] == 403, wrong
        with pytest.raises(InvalidStatus, match="403"):
            viewer(bare)


def test_a_viewer_gets_the_newest_frame_raw_too_and_in_colours_of_his_own(live, viewer):
    looking, other = viewer(), viewer()
    live.show(3)
    (corrected,), status = looking.ask()
    assert corrected.shape == (60, 80)
    assert (status["number"], status["state"], status["keyframes"]) == (3, "learning", 3)
    assert other.ask(palette="turbo", tones="clahe")[0][0].ndim == 3
    live.show()
    pictures, status = looking.ask(seen=3, raw=True, palette="ironbow")
    assert [picture.shape for picture in pictures] == [(60, 80, 3)] * 2
    assert status["number"] == 4


def test_a_viewer_who_has_the_newest_frame_hears_how_it_goes(live, viewer):
    looking = viewer()
    assert looking.ask() == ([], {"number": 0, "ended": "", "recording": False, "recorded": 0, "recorder": ""})
    live.show()
    live.session.end("the recording has ended")
    pictures, status = looking.ask(seen=1)
    assert (pictures, status["ended"]) == ([], "the recording has ended")


def test_nothing_is_made_while_nobody_looks(live, address, made):
    live.show(20)
    time.sleep(0.05)
    assert made == []


def test_a_viewer_who_does_not_read_stalls_nothing_and_fills_no_queue(live, viewer, made):
    rng = np.random.default_rng(0)
    large = rng.normal(8000, 100, (512, 640)).astype(np.float32)
    live.corrected = play(iter([large] * 50), live.corrector)
    live.show()
    stuck, looking = viewer(max_queue=1), viewer()
    for _ in range(300):
        stuck.send(palette="turbo")
    longest = 0.0
    for _ in range(20):
        begun = time.perf_counter()
        live.show()
        longest = max(longest, time.perf_counter() - begun)
        assert looking.ask()[1]["number"] == live.session.newest.number
    assert longest < 1.0
    written = 0
    while written < (written := len(made)):
        time.sleep(0.5)
    assert written < 150  # what the system's buffers take


def test_a_viewer_who_is_cut_off_leaves_the_others_alone(live, viewer):
    live.show()
    gone, looking = viewer(), viewer()
    gone.send(seen=1)
    gone.socket.socket.setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, struct.pack("ii", 1, 0))
    gone.socket.socket.shutdown(socket.SHUT_RDWR)
    live.show()
    assert looking.ask(seen=1)[1]["number"] == 2


def test_hold_and_reset_are_carried_out_with_the_next_frame(live, viewer):
    looking = viewer()
    live.show(80)
    assert live.corrector.status.keyframes > 0
    looking.ask(command="hold")
    taken = live.show().status.keyframes
    live.show(5)
    _, status = looking.ask()
    assert (status["state"], status["holding"], status["keyframes"]) == ("holding", True, taken)
    looking.ask(command="learn")
    live.show()
    assert not live.corrector.hold
    looking.ask(command="reset")
    live.show()
    assert live.corrector.status.frames == 0


def test_a_recording_is_started_and_stopped(live, viewer, tmp_path):
    looking = viewer()
    live.show()
    looking.ask(command="record")
    live.show(5)
    assert looking.ask(command="stop")[1]["recording"]
    live.show()
    live.recorder.close()
    assert looking.ask()[1]["recorder"].startswith("5 frame(s) are in")
    assert len(list((tmp_path / "recordings").glob("*.tif"))) == 2


@pytest.mark.parametrize(
    "sent",
    [
        {"palette": "../../etc/passwd"},
        {"command": "format"},
        {"point": [2, 0]},
        {"point": [float("nan"), 0]},
        {"path": "x.tif"},
        {"tones": "x" * 9000},
        b"\0",
    ],
)
def test_a_malformed_request_closes_the_socket(live, viewer, sent):
    looking = viewer()
    looking.socket.send(sent) if isinstance(sent, bytes) else looking.send(**sent)
    with pytest.raises(ConnectionClosed, match=r"1008|1009"):
        looking.socket.recv(10)
    live.show()
    assert viewer().ask()[1]["number"] == 1


def test_the_values_at_a_point_are_those_of_the_frames(live, viewer):
    live.session.radiometry = Linear(0.01, 200.0)
    frame = live.show(75)
    _, status = viewer().ask(point=[0.999, 0.0])
    spot = status["spot"]
    assert (spot["x"], spot["y"], status["unit"]) == (79, 0, "counts")
    assert spot["raw"] == frame.raw[0, 79]
    assert spot["corrected"] == frame.corrected[0, 79]
    assert status["kelvin"] == pytest.approx([200 + 0.01 * limit for limit in status["limits"]])
    assert spot["kelvin"] == pytest.approx(200 + 0.01 * float(frame.corrected[0, 79]))


def test_snapshots_are_the_corrected_frame(live, address):
    assert get(address, "snapshot.tif")[0] == 404
    frame = live.show(75)
    status, headers, content = get(address, "snapshot.tif")
    assert (status, headers["Content-Disposition"]) == (200, 'attachment; filename="frame-75.tif"')
    assert np.array_equal(tifffile.imread(io.BytesIO(content)), frame.corrected)
    picture = get(address, "snapshot.png?palette=magma&tones=percentile")[2]
    shown = apply_palette(percentile(frame.corrected), "magma")
    assert np.array_equal(np.asarray(Image.open(io.BytesIO(picture))), shown)
    assert get(address, "snapshot.png?palette=pink&tones=percentile")[0] == 404
    assert get(address, "palettes/pink.png")[0] == 404


def test_the_end_takes_no_time_however_many_look(live, viewer):
    with serve(live.session, "127.0.0.1", 0) as address:
        looking = [viewer(address) for _ in range(3)]
        for each in looking:
            each.send(seen=0)
        begun = time.monotonic()
    assert time.monotonic() - begun < 2
