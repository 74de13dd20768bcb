"""The report of a run as one page of HTML, its verdict first."""

from __future__ import annotations

import base64
import hashlib
import json
import zlib
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from deepir.arrays import Array
from deepir.io.output import to_json_types, write_text
from deepir.io.radiometry import KELVIN, unit_metadata
from deepir.io.tone_mapping import DEVIATIONS, PALETTES, SIGNED, WHITE_HOT, colour_table, display_limits
from deepir.messages import DISTRUSTED, NOTES, WARNINGS, by_importance, labelled
from deepir.paths import printable
from deepir.report.panels import evenly_spaced

if TYPE_CHECKING:
    from deepir.config.schema import Config
    from deepir.result import Result

WEB_FOLDER = Path(__file__).parent / "web"  # templates, scripts and styles
#: Palettes of maps about a centre, of standard deviations and of masks.
MAP_PALETTES = {"signed": SIGNED, "spread": DEVIATIONS, "mask": WHITE_HOT}
MISSING_LEVEL = 65535  # level of samples that are not finite
FINE_LEVELS = 4096  # levels between the display limits
COARSE_LEVELS = 256  # the same, at least, of maps with far outliers
HISTOGRAM_BINS = 160  # bins between the display limits


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
    parts = {"policy": policy, "style": style, "body": _read(body), "script": script, "data": json_for_html(data)}
    page = _read("page.html")
    for name, text in parts.items():
        page = page.replace(f"%{name}%", text)
    write_text(path, page)


def _read(name: str) -> str:
    return (WEB_FOLDER / name).read_text(encoding="utf-8")


def _digest(text: str) -> str:
    return f"'sha256-{base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()}'"


def json_for_html(data: Mapping[str, Any]) -> str:
    """JSON that cannot end the element it stands in: no `<`; control characters but new lines are escaped."""
    return json.dumps(_visible(to_json_types(data)), allow_nan=False, separators=(",", ":")).replace("<", "\\u003c")


def _visible(value: Any) -> Any:
    if isinstance(value, dict):
        return {printable(key): _visible(each) for key, each in value.items()}
    if isinstance(value, list):
        return [_visible(each) for each in value]
    return "\n".join(map(printable, value.split("\n"))) if isinstance(value, str) else value


class Verdict(NamedTuple):
    """Good, care or bad; the sentence; and what there is to say or to do beside."""

    severity: str
    sentence: str
    more: str


def verdict(result: Result) -> Verdict:
    """The verdict on a result: its most important warning, or what it reached."""
    used, count = int(result.frames_used.sum()), len(result.frames_used)
    frames = "All frames are used." if used == count else f"{used} of {count} frames are used."
    return warned(result.messages) or Verdict("good", _reached(result), frames)


def warned(messages: Sequence[str]) -> Verdict | None:
    """The verdict of the most important of some messages; None without a warning."""
    warnings = [each for each in by_importance(messages) if each[0] not in NOTES]
    if not warnings:
        return None
    (name, text), more = warnings[0], len(warnings) - 1
    meaning, advice = WARNINGS.get(name, (text, ""))
    what, _, rest = meaning.partition(". ")
    severity = "bad" if name in DISTRUSTED else "care"
    start = {"bad": "Do not trust this result", "care": "Use this result with care"}[severity]
    others = f"{more} more warning{'s are' if more > 1 else ' is'} below." if more else ""
    sentence = f"{start}: {what[:1].lower()}{what[1:].rstrip('.')}."
    return Verdict(severity, sentence, " ".join(filter(None, (rest, advice, others))))


def _reached(result: Result) -> str:
    """What an untroubled result has reached, in a sentence."""
    left: dict[str, Any] = result.metrics.get("fixed_pattern_left") or {}
    if {"raw", "corrected"} <= left.keys():
        was = f"{left['raw']:.3g} {_unit(result)}".strip()
        return f"The pattern was separated from the scene: {was} before, {left['corrected']:.3g} after."
    if np.ptp(result.gain) or np.ptp(result.offset):
        return "The pattern was separated from the scene."
    return "Nothing speaks against this result."


def write_report(path: Path, result: Result, example: Array, config: Config) -> None:
    """Write the page.

    Args:
        path: The page.
        result: The result of the run.
        example: (h, w), a raw frame on the grid of the scene, or a coarser one.
        config: The configuration of the run.
    """
    from deepir.config import dump

    source = config.data.path
    data = {
        "title": config.problem,
        "source": "simulated burst" if source is None else printable(Path(source).name),
        "verdict": {name: printable(each) for name, each in verdict(result)._asdict().items()},
        "figures": _figures(result),
        "stop_reason": result.metrics.get("stop_reason", ""),
        "messages": [printable(each) for each in labelled(result.messages)],
        "maps": list(_maps(result, example)),
        "palettes": {name: colours(name) for name in PALETTES},
        "others": {name: colours(each) for name, each in MAP_PALETTES.items()},
        "palette": config.output.palette,
        "stages": _stages(result.history),
        "motion": _motion(result),
        "level": level if np.any(level := np.atleast_2d(result.level)[0]) else [],
        "histogram": _histogram(example, _first(result.scene)),
        "unit": _unit(result),
        "config": dump(config),
        "metrics": {name: value for name, value in result.metrics.items() if name != "messages"},
    }
    write_page(path, "run.html", ("maps.js", "views.js", "plots.js", "curves.js", "run.js"), data)


def _unit(result: Result) -> str:
    """`counts` or `K`; empty where the input has no unit."""
    return str(unit_metadata(result.radiometry).get("unit", ""))


def _maps(result: Result, example: Array) -> Iterator[dict[str, Any]]:
    """The maps in order: name, title, unit, palette, and `pack_map`."""
    here = _unit(result)
    yield packed("raw", "Raw frame", example, here)
    yield from _scenes("scene", "Scene", result.scene, here)
    kelvin = result.extra.get("scene_kelvin")
    if kelvin is not None and result.radiometry != KELVIN:
        yield from _scenes("scene_kelvin", "Temperature", kelvin, "K")
    yield from _scenes("gain", f"Gain, σ {100 * result.gain.std():.1f} %", result.gain, "", centre=1.0)
    yield from _scenes("offset", f"Offset, σ {result.offset.std():.3g}", result.offset, here, centre=0.0)
    for name, image in result.extra.items():
        if image.ndim == 2 and name != "scene_kelvin":
            low, high = display_limits(image.astype(float))
            yield packed(name, name.capitalize(), image, "", centre=0.0 if low < 0 < high else None)
    bad = result.bad_pixels
    yield packed("bad_pixels", f"Bad pixels, {bad.sum()}", _first(bad), "", "mask")
    yield from (
        packed(f"{name}_sd", f"Uncertainty of the {name}", _first(image), "" if name == "gain" else here, "spread")
        for name, image in result.uncertainty.items()
        if image.ndim > 1 and name != "motion"
    )


def _scenes(
    name: str, title: str, scenes: Array, here: str, *, centre: float | None = None
) -> Iterator[dict[str, Any]]:
    """The scene; where each frame or band has its own, that of the first by this name, and some others."""
    yield packed(name, title, _first(scenes), here, centre=centre)
    if scenes.ndim == 3:
        for other in evenly_spaced(len(scenes))[1:]:
            yield packed(f"{name}_{other}", f"{title} {other}", scenes[other], here, centre=centre)


def _first(scenes: Array) -> Array:
    return scenes if scenes.ndim == 2 else scenes[0]


def packed(
    name: str, title: str, image: Array, here: str, palette: str = "", *, centre: float | None = None
) -> dict[str, Any]:
    """One map; with a `centre` its palette is signed, and symmetric about it.

    Args:
        name: Its name in the page.
        title: Above it.
        image: (h, w).
        here: Its unit.
        palette: One of `MAP_PALETTES`; "": that of the page.
        centre: Of the scale.
    """
    fine = COARSE_LEVELS if palette == "spread" else FINE_LEVELS
    found = {"name": name, "title": title, "unit": here, "colours": palette} | pack_map(image, fine)
    if palette == "mask":
        return found | {"low": 0, "high": 1}
    if centre is None:
        return found
    reach = max(found["high"] - centre, centre - found["low"], 1e-6)
    return found | {"low": centre - reach, "high": centre + reach, "colours": "signed"}


def pack_map(image: Array, fine: int = FINE_LEVELS) -> dict[str, Any]:
    """Levels of a map (h, w) as text, with the data to read them: `value = base + step * level`.

    Levels are differences along x, high bytes first, for compression.

    Args:
        image: (h, w).
        fine: Levels between the display limits.
    """
    whole, image = image.dtype == bool, np.asarray(image, np.float64)
    finite = image[np.isfinite(image)]
    least, most = (finite.min(), finite.max()) if finite.size else (0.0, 0.0)
    low, high = display_limits(image)
    span = high - low or most - least or 1.0
    step = 1.0 if whole else np.clip((most - least) / (MISSING_LEVEL - 1), span / fine, span / COARSE_LEVELS)
    base = max(least, low - step * MISSING_LEVEL / 2)
    levels = np.round((np.where(np.isfinite(image), image, base) - base) / step).clip(0, MISSING_LEVEL - 1)
    levels = np.where(np.isfinite(image), levels, MISSING_LEVEL).astype("<u2", order="C")
    levels[:, 1:] -= levels[:, :-1].copy()
    planes = levels.view(np.uint8).reshape(-1, 2).T[::-1].tobytes()
    return {
        "height": image.shape[0],
        "width": image.shape[1],
        "base": float(base),
        "step": float(step),
        "low": low,
        "high": high if high > low else low + span,
        "levels": base64.b64encode(zlib.compress(planes, 1)).decode(),
    }


def colours(palette: str) -> str:
    """The 256 colours of a palette, as text for the page."""
    return base64.b64encode(colour_table(palette).tobytes()).decode()


def _figures(result: Result) -> list[tuple[str, str]]:
    """The figures that matter most, with their names."""
    found, here = result.metrics, _unit(result)
    shown = {
        "psnr_aligned": ("PSNR", "{:.1f} dB"),
        "held_out_rmse": ("held-out error", f"{{:.3g}} {here}"),
        "noise_sigma": ("noise σ", f"{{:.3g}} {here}"),
        "pattern_cost_db": ("cost of the pattern", "{:.1f} dB"),
        "seconds": ("time", "{:.1f} s"),
    }
    used = f"{int(result.frames_used.sum())} of {len(result.frames_used)}"
    numbers = {key: value for key, value in found.items() if isinstance(value, int | float) and np.isfinite(value)}
    known = [(name, form.format(numbers[key])) for key, (name, form) in shown.items() if key in numbers]
    return [*known, ("frames used", used)]


def _stages(history: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Name, losses and held-out errors (iteration, error) of each stage."""
    stages: dict[str, dict[str, Any]] = {}
    for row in history:
        stage = stages.setdefault(row["stage"], {"name": row["stage"], "loss": [], "held_out": []})
        stage["loss"].append(row["loss"])
        if "held_out" in row:
            stage["held_out"].append((len(stage["loss"]), row["held_out"]))
    return list(stages.values())


def _motion(result: Result) -> list[tuple[int, float, float, float]]:
    """Frame, displacement of its centre (x, y in px of the scene's grid), and rotation in degrees."""
    rows = []
    for frame in np.flatnonzero(result.frames_used):
        m = result.motion[frame]
        turn = np.degrees(np.arctan2(m[1, 0] - m[0, 1], m[0, 0] + m[1, 1]))
        rows.append((int(frame), m[0, 2] / m[2, 2], m[1, 2] / m[2, 2], turn))
    return rows


def _histogram(raw: Array, scene: Array) -> dict[str, Any]:
    """Shares of the pixels in bins over what both span, percentiles 0.5 to 99.5."""
    limits = [display_limits(image) for image in (raw, scene)]
    low, high = min(each for each, _ in limits), max(each for _, each in limits)
    high = high if high > low else low + 1.0
    shares = {
        name: np.histogram(image, HISTOGRAM_BINS, (low, high))[0] / max(image.size, 1)
        for name, image in {"raw frame": raw, "scene": scene}.items()
    }
    return {"low": low, "high": high, "shares": shares}
