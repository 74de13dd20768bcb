"""The page in a browser: as its user sees it."""

import threading
import time

import numpy as np
import pytest
import tifffile

FRAME = "+(document.documentElement.dataset.frame ?? 0)"
PATIENCE = 10.0  # s


@pytest.fixture
def page(browser, address):
    """The page, opened; it must load nothing of others and complain of nothing."""
    context, wrong = browser.new_context(viewport={"width": 1200, "height": 800}), []
    opened = context.new_page()
    opened.on("console", lambda message: wrong.append(message.text))
    opened.on("pageerror", lambda error: wrong.append(str(error)))
    opened.on("request", lambda request: request.url.startswith(address) or wrong.append(request.url))
    opened.goto(address)
    yield opened
    context.close()
    assert wrong == []


@pytest.fixture
def running(live):
    """Frames come, 100 a second."""
    ended = threading.Event()

    def run():
        while not ended.wait(0.01):
            live.show()

    thread = threading.Thread(target=run)
    thread.start()
    yield live
    ended.set()
    thread.join()


def until(page, condition):
    """Wait; the page's own `wait_for_function` evaluates text, which its content policy forbids."""
    end = time.monotonic() + PATIENCE
    while not condition() and time.monotonic() < end:
        page.wait_for_timeout(10)
    assert condition()


def arrive(page, count=1):
    """Wait for some more frames."""
    before = page.evaluate(FRAME)
    until(page, lambda: page.evaluate(FRAME) >= before + count)


def show(page, live):
    """Show a frame, and wait until the page has it."""
    frame = live.show()
    until(page, lambda: page.evaluate(FRAME) == frame.number)
    return frame


def colours(page, canvas="#corrected"):
    """Of all pixels, (h, w, 4)."""
    script = """canvas => {
        const copy = new OffscreenCanvas(80, 60).getContext("2d");
        copy.drawImage(canvas, 0, 0);
        return [...copy.getImageData(0, 0, 80, 60).data];
    }"""
    return np.reshape(page.eval_on_selector(canvas, script), (60, 80, 4))


def headline(page, words):
    until(page, lambda: page.inner_text("#headline") == words)


def test_frames_arrive_and_are_corrected_from_the_first_estimate_on(page, running):
    headline(page, "Correcting")
    arrive(page)
    assert page.inner_text("#figures [data-name=estimates] dd") != "0"
    assert page.title() == "drive.avi – deepir live"
    shown = [colours(page, each)[..., 0] for each in ("#raw", "#corrected")]
    rough = [np.median(np.abs(np.diff(each))) for each in shown]  # inside the squares of the picture
    assert rough[1] < 0.3 * rough[0]


def test_hold_is_pressed_until_it_is_let_go_and_a_recording_until_it_is_stopped(page, running):
    headline(page, "Correcting")
    page.click("#hold")
    headline(page, "Holding")
    assert running.corrector.hold
    assert page.get_attribute("#hold", "aria-pressed") == "true"
    page.click("#hold")
    headline(page, "Correcting")
    page.click("#record")
    until(page, lambda: page.inner_text("#record") == "Stop")
    arrive(page)
    page.click("#record")
    until(page, lambda: "frame(s) are in" in page.inner_text("#recorder"))


def test_reset_asks_first(page, running):
    headline(page, "Correcting")
    page.once("dialog", lambda dialog: dialog.dismiss())
    page.click("#reset")
    arrive(page)
    headline(page, "Correcting")
    page.once("dialog", lambda dialog: dialog.accept())
    seen = running.corrector.status.frames
    page.click("#reset")
    until(page, lambda: running.corrector.status.frames < seen)


def test_a_palette_colours_the_picture_and_its_scale(page, live):
    show(page, live)
    assert np.ptp(colours(page)[..., :3].astype(int), axis=-1).max() == 0
    page.check("input[value=ironbow]", force=True)
    until(page, lambda: np.ptp(colours(page)[..., :3].astype(int), axis=-1).max() > 50)
    assert page.get_attribute("#bar", "src") == "palettes/ironbow.png"
    assert page.get_attribute("#png", "href") == "snapshot.png?palette=ironbow&tones=percentile"


def test_the_slider_parts_raw_from_corrected(page, live):
    show(page, live)
    box = page.locator("#pair").bounding_box()
    handle = lambda: page.locator(".handle").bounding_box()["x"] + 1 - box["x"]  # noqa: E731
    assert handle() / box["width"] == pytest.approx(0.5, abs=0.01)
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + 50)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 4, box["y"] + 50)
    page.mouse.up()
    assert handle() / box["width"] == pytest.approx(0.25, abs=0.01)
    page.keyboard.press("ArrowRight")
    assert handle() / box["width"] == pytest.approx(0.255, abs=0.01)


def test_a_point_is_read_by_mouse_and_by_keys(page, live):
    frame = show(page, live)
    box = page.locator("#pair").bounding_box()
    spot = {"x": box["width"] * 60.5 / 80, "y": box["height"] * 10.5 / 60}

    def reads(x, y):
        words = f"x {x}, y {y} · corrected {frame.corrected[y, x]:.0f} counts · raw {frame.raw[y, x]} counts"
        until(page, lambda: page.inner_text("#reading") == words)

    page.hover("#pair", position=spot)
    reads(60, 10)
    page.click("#pair", position=spot)
    page.mouse.move(0, 0)
    page.focus("#pair")
    page.keyboard.press("ArrowLeft")
    page.keyboard.press("Shift+ArrowDown")
    reads(59, 20)
    page.keyboard.press("Escape")
    assert not page.is_visible("#cross")


def test_a_snapshot_holds_the_values(page, live):
    frame = live.show()
    with page.expect_download() as download:
        page.click("#tif")
    assert download.value.suggested_filename == "frame-1.tif"
    assert np.array_equal(tifffile.imread(download.value.path()), frame.corrected)


def test_the_end_is_reported_and_the_last_frame_stays(page, live):
    live.show()
    live.session.end("the recording has ended")
    headline(page, "Ended")
    assert page.is_disabled("#hold")
    assert colours(page).any()


def test_a_phone_shows_all_of_it_without_scrolling_aside(page, live):
    page.set_viewport_size({"width": 360, "height": 740})
    show(page, live)
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    assert page.locator("#pair").bounding_box()["width"] > 320
