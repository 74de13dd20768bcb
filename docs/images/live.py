"""The picture in docs/how-to/live.md: run its commands with `walk.npz`, and this meanwhile. Needs Chromium."""

import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

PAGE = "http://127.0.0.1:8265/"


def main() -> None:
    """Write docs/images/live.png: the page once frames are corrected, with a point being read."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1180, "height": 740}, color_scheme="dark")
        page.goto(PAGE)
        page.check("input[value=ironbow]", force=True)
        page.wait_for_selector("#state[data-kind=correcting]", timeout=120_000)
        box = page.locator("#pair").bounding_box()
        page.click("#pair", position={"x": 0.765 * box["width"], "y": 0.6 * box["height"]})
        page.wait_for_timeout(500)
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        browser.close()
    small = picture.quantize(256, Image.Quantize.FASTOCTREE, dither=Image.Dither.NONE)
    small.save(Path(__file__).with_name("live.png"), optimize=True)


if __name__ == "__main__":
    main()
