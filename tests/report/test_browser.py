"""`report.html` in a browser: as its reader uses it."""

import pytest

from deepir.messages import Message
from deepir.report.html import write_report

PAIR = "#compare .pair"


@pytest.fixture
def report(tmp_path, result, example, config, visit):
    """Write the report, and open it."""

    def opened(**options):
        path = tmp_path / "report.html"
        write_report(path, result, example, config)
        return visit(path, **options)

    return opened


def colour(page, canvas, x=5, y=5):
    """Red, green, blue of a pixel of a canvas."""
    return page.eval_on_selector(
        canvas,
        """(canvas, [x, y]) => {
            const copy = new OffscreenCanvas(1, 1).getContext("2d", { willReadFrequently: true });
            copy.drawImage(canvas, -x, -y);
            return [...copy.getImageData(0, 0, 1, 1).data].slice(0, 3);
        }""",
        [x, y],
    )


def split(page):
    """Where the slider parts before from after, as a fraction."""
    return page.eval_on_selector(
        PAIR, "p => (document.querySelector('.handle').getBoundingClientRect().left + 1"
        " - p.getBoundingClientRect().left) / p.clientWidth"
    )  # fmt: skip


def test_the_slider_goes_where_it_is_dragged(report):
    page = report()
    assert split(page) == pytest.approx(0.5, abs=0.01)
    box = page.locator(PAIR).bounding_box()
    middle = box["y"] + box["height"] / 2
    page.mouse.move(box["x"] + box["width"] / 2, middle)
    page.mouse.down()
    page.mouse.move(box["x"] + box["width"] / 5, middle)
    page.mouse.up()
    assert split(page) == pytest.approx(0.2, abs=0.02)


def test_the_slider_moves_by_the_arrow_keys(report):
    page = report()
    page.focus(f"{PAIR} input")
    for _ in range(4):
        page.keyboard.press("ArrowRight")
    assert split(page) == pytest.approx(0.52, abs=0.005)
    page.keyboard.press("Home")
    assert split(page) == pytest.approx(0, abs=0.005)


def test_the_pointer_reads_counts_and_kelvin_of_the_pixel_under_it(report):
    page = report()
    box = page.locator(PAIR).bounding_box()
    page.mouse.move(box["x"] + box["width"] * 10.5 / 64, box["y"] + box["height"] * 20.5 / 48)
    text = page.inner_text("#compare .reading")
    assert text.startswith("x 10, y 20 · raw ")
    assert "scene 8010" in text
    assert "280.10" in text
    assert text.endswith("K")
    assert "x 10, y 20" in page.inner_text("#maps .card:nth-child(3) .reading"), "read in the gain too"


def test_a_map_is_read_by_the_keyboard(report):
    page = report()
    page.focus("#maps .card:nth-child(1) .map")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("Shift+ArrowLeft")
    page.keyboard.press("ArrowUp")
    assert "x 23, y 23 · 8023" in page.inner_text("#said")
    page.keyboard.press("Escape")
    assert page.locator(".cross:visible").count() == 0


def test_a_palette_colours_pictures_and_leaves_signs_alone(report):
    page = report()
    scene, gain = "canvas.after", "#maps .card:nth-child(3) canvas"
    before = colour(page, gain)
    red, green, blue = colour(page, scene, 32)
    assert red == green == blue
    page.check("#palette input[value=ironbow]", force=True)
    red, green, blue = colour(page, scene, 32)
    assert red > green > blue
    assert colour(page, gain) == before
    page.keyboard.press("ArrowRight")
    assert page.is_checked("#palette input[value=inferno]")


def test_the_hottest_is_white_and_the_coldest_black(report):
    page = report()
    assert colour(page, "canvas.after", 0) == [0, 0, 0]
    assert colour(page, "canvas.after", 63) == [255, 255, 255]


def test_a_larger_map_takes_the_whole_width(report):
    page = report()
    card = page.locator("#maps .card").first
    small = card.bounding_box()["width"]
    card.locator("button").click()
    assert card.bounding_box()["width"] > 2 * small


def test_hostile_text_is_shown_as_it_is(report, result):
    hostile = "</script><script>alert(1)</script><img src=x onerror=alert(2)>"
    result.messages = [hostile]
    result.metrics["stop_reason"] = hostile
    result.extra[hostile] = result.extra.pop("stray")
    page = report()
    assert page.inner_text("#messages li") == f"warning: {hostile}"
    assert hostile in page.inner_text("#verdict")
    assert page.locator("img").count() == 0
    assert hostile.capitalize() in page.inner_text("#maps .card:nth-child(6) figcaption")


def test_curves_say_what_is_under_the_pointer(report):
    page = report()
    titles = page.locator("#plots figcaption").all_inner_texts()
    assert titles == [
        "Loss of each stage, less its least", "Held-out error", "Motion of the frame's centre", "Histogram",
    ]  # fmt: skip
    page.locator("#plots .card:nth-child(3) circle.dot").nth(1).hover()
    assert page.inner_text("#plots .card:nth-child(3) .reading") == "frame 1: x 3, y −2 px, turned 0.00°"
    page.focus("#plots .card:nth-child(1) svg")
    page.keyboard.press("ArrowRight")
    page.keyboard.press("ArrowRight")
    assert page.inner_text("#plots .card:nth-child(1) .reading") == "scene 2: loss 500"


def test_the_first_screen_of_a_phone_says_whether_to_trust_the_result(report, result):
    result.messages = [
        Message("scene-in-pattern", "the pattern looks like the scene"),
        Message("line-noise", "rows jump"),
        Message("motion-small", "the frames move by 1 px"),
    ]
    page = report(has_touch=True, is_mobile=True, device_scale_factor=3)
    page.set_viewport_size({"width": 360, "height": 740})
    box = page.locator("#verdict").bounding_box()
    assert box["y"] + box["height"] < 740 / 2
    assert page.get_attribute("#verdict", "class") == "bad"
    assert page.inner_text("#verdict").startswith("Do not trust this result: the estimated pattern looks like")
    assert page.inner_text("#verdict code") == "data.mask"
    colours = page.eval_on_selector_all(
        "#messages li", "all => all.map(each => getComputedStyle(each).borderLeftColor)"
    )
    assert colours[0] == colours[1] != colours[2], "a note looks other than a warning"


def test_a_phone_shows_all_of_it_without_scrolling_aside(report):
    page = report(has_touch=True, is_mobile=True, device_scale_factor=3)
    page.set_viewport_size({"width": 360, "height": 740})
    assert page.evaluate("document.documentElement.scrollWidth") == 360
    page.locator("#maps .map").first.tap()
    assert "8032" in page.inner_text("#maps .card:nth-child(1) .reading")


def test_dark_or_light_is_as_the_system_is_until_it_is_switched(report):
    page = report(color_scheme="dark")
    ground = "getComputedStyle(document.body).backgroundColor"
    dark = page.evaluate(ground)
    page.click("#theme")
    assert page.evaluate(ground) != dark
    page.click("#theme")
    assert page.evaluate(ground) == dark


def test_a_run_of_which_little_is_known_has_a_report_too(report, result):
    result.history, result.extra, result.uncertainty, result.metrics = [], {}, {}, {}
    result.radiometry = None
    result.motion[1:] = float("nan")
    result.frames_used[1:] = False
    result.scene[:5] = float("nan")
    page = report()
    assert page.locator("#maps .card").count() == 4
    assert page.locator("#plots .card").count() == 1
