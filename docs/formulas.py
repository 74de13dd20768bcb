"""Formulas of the site as pictures in the page, drawn by matplotlib: mkdocs calls this, see mkdocs.yml.

A script that draws them in the browser would come from another server.
"""

from __future__ import annotations

import re
from html import escape
from typing import Any

from matplotlib.font_manager import FontProperties
from matplotlib.textpath import TextPath
from mkdocs.structure.pages import Page

#: Code, which is left alone, and formulas: `$$...$$` on lines of their own, `$...$` within a line.
PARTS = re.compile(r"(?P<code>^```.*?^```$|`[^`\n]*`)|\$\$(?P<display>.+?)\$\$|\$(?P<inline>[^$\n]+?)\$", re.M | re.S)
FONT = FontProperties(math_fontfamily="stix")
SIZE = 100.0  # units of a drawing to the size of its font
EM = 85.0  # units of a drawing to the size of the text, whose letters are taller than the formulas'
MARGIN = 4.0  # units around a drawing
COMMANDS = {1: "M", 2: "L", 3: "Q", 4: "C"}  # codes of matplotlib's paths in those of SVG


def on_page_markdown(markdown: str, page: Page, **_: Any) -> str:
    """Replace formulas by marks that Markdown leaves as they are."""
    page.meta["formulas"] = formulas = []

    def mark(found: re.Match[str]) -> str:
        if found["code"]:
            return found[0]
        formulas.append(drawn(found["inline"] or found["display"], display=bool(found["display"])))
        return f"FORMULA{len(formulas) - 1}MARK"

    return PARTS.sub(mark, markdown)


def on_page_content(html: str, page: Page, **_: Any) -> str:
    """Replace the marks by the drawings."""
    return re.sub(r"FORMULA(\d+)MARK", lambda found: page.meta["formulas"][int(found[1])], html)


def drawn(formula: str, *, display: bool) -> str:
    """A formula in LaTeX as an SVG of the text's colour, on its line or centred."""
    latex = " ".join(formula.split())
    path = TextPath((0, 0), f"${latex}$", size=SIZE, prop=FONT)
    left, bottom, right, top = path.get_extents().padded(MARGIN).extents
    lines = (
        COMMANDS.get(code, "Z") + " ".join(f"{value:.0f}" for value in points * (code in COMMANDS))
        for points, code in ((list(points), code) for points, code in path.iter_segments(simplify=False))
    )
    style = f"height:{(top - bottom) / EM:.2f}em;vertical-align:{bottom / EM:.2f}em"
    box = f"{left:.0f} {-top:.0f} {right - left:.0f} {top - bottom:.0f}"
    if display:
        style = f"display:block;margin:auto;max-width:100%;{style}"
    return (
        f'<svg role="img" aria-label="{escape(latex)}" viewBox="{box}" style="{style}">'
        f'<path fill="currentColor" transform="scale(1,-1)" d="{"".join(lines)}"/></svg>'
    )
