"""The picture of a report in docs/reference/cli.md: `deepir demo`, then this, both in the root. Needs Chromium."""

import io
import shutil
from pathlib import Path

from PIL import Image
from playwright.sync_api import sync_playwright

REPORT = Path("runs/demo/report.html")


def main() -> None:
    """Write docs/images/report.png: the report's upper part in ironbow, with a point being read."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1280, "height": 935}, color_scheme="dark")
        page.goto(REPORT.absolute().as_uri())
        page.wait_for_selector("html[data-ready]")
        page.check("#palette input[value=ironbow]", force=True)
        page.hover("#compare .pair", position={"x": 600, "y": 470})
        picture = Image.open(io.BytesIO(page.screenshot())).convert("RGB")
        browser.close()
    small = picture.quantize(256, dither=Image.Dither.NONE)
    small.save(Path(__file__).with_name("report.png"), optimize=True)


if __name__ == "__main__":
    main()
