"""One self-contained HTML page: a template with body, style, scripts and data."""

from __future__ import annotations

import base64
import hashlib
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from deepir.io.output.write import atomic_file, to_json_types
from deepir.paths import printable

WEB_FOLDER = Path(__file__).parent / "web"  # templates, scripts and styles


def write_page(path: Path, body: str, scripts: Sequence[str], data: Mapping[str, Any]) -> None:
    """Write a page; its scripts find `data` as JSON in `#data`.

    The content policy allows these scripts and this style by their digests, and no network access: text that passed the
    escaping would not run.

    Args:
        path: The page.
        body: Name of the body in the folder `web`.
        scripts: Names of the scripts in the folder `web`.
        data: The data.
    """
    style = _read("page.css")
    script = "".join(map(_read, ("page.js", *scripts)))
    policy = f"default-src 'none'; style-src {_digest(style)}; script-src {_digest(script)}"
    parts = {
        "policy": policy,
        "style": style,
        "body": _read(body),
        "script": script,
        "data": json_for_html(data),
    }
    page = _read("page.html")
    for name, text in parts.items():
        page = page.replace(f"%{name}%", text)
    with atomic_file(path) as part:
        part.write_text(page, encoding="utf-8")


def _read(name: str) -> str:
    return (WEB_FOLDER / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def json_for_html(data: Mapping[str, Any]) -> str:
    """JSON that cannot end the element it stands in: no `<`; control characters but new lines are escaped."""
    return json.dumps(_visible(to_json_types(data)), allow_nan=False, separators=(",", ":")).replace(
        "<", "\\u003c"
    )


def _visible(value: Any) -> Any:
    if isinstance(value, dict):
        return {printable(key): _visible(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_visible(each) for each in value]
    return "\n".join(map(printable, value.split("\n"))) if isinstance(value, str) else value
