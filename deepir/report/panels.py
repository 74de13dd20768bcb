"""Pictures of results beside each other: of a run, a recording, a dense motion and an analysis."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from PIL import Image

from deepir.analysis import CORRELATION_LENGTH_LEVEL, STABILITY_LEVEL
from deepir.arrays import Array
from deepir.io import atomic_file
from deepir.io.tone_mapping import DEVIATIONS, SIGNED, WHITE_HOT, colour_table, stretch
from deepir.report.drawing import COLOURS, Axes, Scale, composed, draw_colours, draw_map, map_height, write_figure

if TYPE_CHECKING:
    from deepir.analysis import BurstAssessment, PatternStatistics
    from deepir.recording.correct import CorrectedRecording
    from deepir.result import Result

TOTAL_WIDTH = 1200  # px
Panel = tuple[str, np.ndarray[Any, Any], float, float]
SHOWN = (0.1, 0.5, 0.9)  # places in the recording of the frames shown
PERCENTILES = (0.5, 99.5)  # of a picture's values, shown black and white
PANEL_WIDTH = 460  # px
PANEL_HEIGHTS = (260, 900)  # px, least and greatest
FLOW_WIDTH, LEGEND_WIDTH = 330, 260  # px, of the picture of dense motion
ANALYSIS_SIZE = (520, 390)  # px, width and height of a panel of an analysis
FARTHEST_LAG = 25  # px, of its curves along x and y
LEGEND_SHARE = 0.3  # of the height of the losses, kept free above them


def montage(scenes: np.ndarray[Any, Any]) -> np.ndarray[Any, Any]:
    """One picture of a scene (H, W), or of up to four of the scenes (N, H, W) side by side."""
    if scenes.ndim == 2:
        return scenes
    chosen = scenes[evenly_spaced(len(scenes))]
    rows = [np.concatenate(list(pair), axis=1) for pair in (chosen[:2], chosen[2:]) if len(pair)]
    missing = rows[0].shape[1] - rows[-1].shape[1]
    rows[-1] = np.pad(rows[-1], ((0, 0), (0, missing)), constant_values=np.nan)
    return np.concatenate(rows)


def evenly_spaced(count: int) -> list[int]:
    """Four or fewer of `count` indices, from the first to the last."""
    found: list[int] = np.linspace(0, count - 1, min(count, 4)).round().astype(int).tolist()
    return found


def write_panels(path: Path, panels: Sequence[Panel], rows: int = 1) -> None:
    """Write a PNG of (title, picture (h, w), value of black, value of white), in `rows`, 64 grey levels."""
    columns = -(-len(panels) // rows)
    width = TOTAL_WIDTH // columns
    size = width, map_height(panels[0][1].shape, width, 0)
    grey = [colour_table(WHITE_HOT)[np.round(255 * stretch(each, *ends)).astype(np.uint8)] for _, each, *ends in panels]
    drawn = [draw_colours(colours, panel[0], size) for colours, panel in zip(grey, panels, strict=True)]
    whole = composed([drawn[k : k + columns] for k in range(0, len(drawn), columns)]).convert("L")
    whole.quantize(64, dither=Image.Dither.NONE).save(path, format="PNG", optimize=True)


def write_correction(path: Path, corrected: CorrectedRecording) -> None:
    """Write the picture: three frames as recorded, the same corrected, and offset, gain and bad pixels."""
    keyframes = corrected.keyframes
    chosen = [int(place * (len(keyframes.frames) - 1)) for place in SHOWN]
    before = [keyframes.frames[k] for k in chosen]
    numbers = [int(keyframes.numbers[k]) for k in chosen]
    after = [corrected.correct(*each) for each in zip(before, numbers, strict=True)]
    estimate = corrected.estimate
    panels = [
        *(_panel(f"frame {number}, recorded", frame) for number, frame in zip(numbers, before, strict=True)),
        *(_panel(f"frame {number}, corrected", frame) for number, frame in zip(numbers, after, strict=True)),
        _panel(f"offset, std {estimate.offset[~estimate.bad_pixels].std():.3g}", estimate.offset),
        _panel(f"gain, std {100 * estimate.gain[~estimate.bad_pixels].std():.2g} %", estimate.gain),
        ("bad pixels", estimate.bad_pixels.astype(float), 0.0, 1.0),
    ]
    with atomic_file(path) as part:
        write_panels(part, panels, rows=3)


def _panel(title: str, picture: Array) -> Panel:
    low, high = (float(each) for each in np.nanpercentile(picture, PERCENTILES))
    if low == high:  # a uniform picture is grey
        low, high = low - 0.5, high + 0.5
    return title, picture, low, high


def write_summary(path: Path, result: Result, example: Array) -> None:
    """Write the picture; `example` is a raw frame (h, w)."""
    size = PANEL_WIDTH, int(np.clip(map_height(example.shape, PANEL_WIDTH), *PANEL_HEIGHTS))
    scene = result.scene
    above = [
        draw_map(example, "raw frame", WHITE_HOT, size),
        draw_map(scene if scene.ndim == 2 else scene[0], "scene", WHITE_HOT, size),
    ]
    if scene.ndim == 3:
        above.append(draw_map(montage(scene), f"some of the {len(scene)} scenes", WHITE_HOT, size))
    elif "scene" in result.uncertainty:
        title = "standard deviation of the scene"
        above.append(draw_map(result.uncertainty["scene"], title, DEVIATIONS, size))
    else:
        above.append(draw_map(scene, "scene, inferno", "inferno", size))
    below = [
        draw_map(montage(result.gain), f"gain, std {100 * result.gain.std():.1f} %", SIGNED, size, centre=1.0),
        draw_map(montage(result.offset), f"offset, std {result.offset.std():.3g}", SIGNED, size, centre=0.0),
    ]
    if result.history:
        below.append(_loss(result.history, size))
    more = {name: each for name, each in result.extra.items() if each.shape == result.gain.shape}
    for k, (name, each) in enumerate(more.items()):
        row = (above, below)[k % 2]
        row.append(draw_map(montage(each), f"{name}, std {each.std():.3g}", SIGNED, size, centre=0.0))
    write_figure(path, [above, below])


def _loss(history: list[dict[str, Any]], size: tuple[int, int]) -> Image.Image:
    stages = {
        stage: np.array([row["loss"] for row in history if row["stage"] == stage])
        for stage in dict.fromkeys(row["stage"] for row in history)
    }
    fallen = {stage: loss - loss.min() + 1 for stage, loss in stages.items()}
    highest = max(float(np.nanmax(each)) for each in fallen.values())
    title = "loss in each stage, less its least (nats)"
    losses = Scale(0.8, 1.4 * highest * highest**LEGEND_SHARE, log=True)
    axes = Axes(size, title, Scale(0, len(history)), losses, "iteration")
    start, colours = 0, dict[str, str]()
    for stage, loss in fallen.items():
        kind = stage.rstrip(" 0123456789")  # the rounds of a stage share a colour and a name
        name = "" if kind in colours else kind
        colour = colours.setdefault(kind, COLOURS[len(colours) % len(COLOURS)])
        axes.line(np.arange(start, start + len(loss)), loss, colour, name)
        start += len(loss)
    return axes.picture()


def write_flow(path: Path, flow: Array, motion: Array) -> None:
    """Write the deviation of some frames' flow from their homographies, with a legend.

    Args:
        path: A .png.
        flow: (N, 2, h, w), x and y, px.
        motion: (N, 3, 3), pull homographies, px.
    """
    import torch

    from deepir.operators.motion_models import displacements
    from deepir.operators.warp import project_pixels

    moved = [k for k in range(len(flow)) if np.isfinite(motion[k]).all() and flow[k].any()]
    shown = [moved[i] for i in evenly_spaced(len(moved))]
    size = flow.shape[2:]
    points = project_pixels(torch.from_numpy(motion[shown]).double(), size)
    beside = flow[shown] - displacements(points).numpy()
    reach = max(float(np.percentile(np.hypot(*beside.swapaxes(0, 1)), 99)), 1e-3) if shown else 1.0
    height = max(map_height(size, FLOW_WIDTH, 0), LEGEND_WIDTH)
    panels = [
        draw_colours(flow_colours(picture / reach), f"frame {k}, beside its homography", (FLOW_WIDTH, height))
        for k, picture in zip(shown, beside, strict=True)
    ]
    write_figure(path, [[*panels, _legend(reach, height)]])


def _legend(reach: float, height: int) -> Image.Image:
    """Colours of the vectors up to `reach`, px."""
    along = np.linspace(-1, 1, 201)
    wheel = np.stack(np.broadcast_arrays(along, along[:, None]))
    colours = np.where(np.hypot(*wheel)[..., None] <= 1, flow_colours(wheel), 255).astype(np.uint8)
    x, y = Scale(-reach, reach), Scale(reach, -reach)
    axes = Axes((LEGEND_WIDTH, height), "px, x right, y down", x, y, square=True)
    axes.image(colours, (-reach, reach, reach, -reach))
    return axes.picture()


def flow_colours(vectors: Array) -> Array:
    """Vectors (2, h, w) as colours (h, w, 3), uint8: white is zero, full colour a length of one or more."""
    hue = np.arctan2(vectors[1], vectors[0]) / (2 * np.pi) % 1
    length = np.hypot(vectors[0], vectors[1]).clip(0, 1)
    levels = np.stack((hue, length, 1 - 0.15 * length), -1)
    whole = np.round(255 * levels).astype(np.uint8)
    return np.asarray(Image.frombytes("HSV", whole.shape[1::-1], whole.tobytes()).convert("RGB"))


def write_analysis(
    path: Path,
    statistics: PatternStatistics,
    assessment: BurstAssessment | None = None,
    scene_deviation: Array | None = None,
) -> None:
    """Write the picture.

    Args:
        path: A .png.
        statistics: Of the pattern.
        assessment: Of the burst, if there is one.
        scene_deviation: (H, W), standard deviation of the scene, if it is known.
    """
    pattern = statistics.pattern
    if statistics.temporal is not None:
        last = _over_time(statistics.temporal)
    elif scene_deviation is not None:
        last = draw_map(scene_deviation, "standard deviation of the scene", DEVIATIONS, ANALYSIS_SIZE)
    else:
        last = Image.new("RGB", ANALYSIS_SIZE, "white")
    above = [
        draw_map(pattern, f"pattern, std {pattern.std():.3g}", SIGNED, ANALYSIS_SIZE, centre=0.0),
        _around(statistics, assessment),
    ]
    write_figure(path, [above, [_along(statistics), last]])


def _around(statistics: PatternStatistics, assessment: BurstAssessment | None) -> Image.Image:
    """The autocorrelation, with the displacements of the frames: pale at points off the centre."""
    middle = len(statistics.correlation) // 2
    edge = middle + 0.5
    view, title = min(edge, 3 * max(statistics.lengths) + 8), "autocorrelation, 0 dark to 1 bright"
    if assessment is not None:
        view = min(edge, max(view, float(np.abs(assessment.displacements).max()) + 2))
        title += ", and where the frames look"
    axes = Axes(ANALYSIS_SIZE, title, Scale(-view, view), Scale(view, -view), "lag in x and y (px)", square=True)
    near = min(middle, int(view) + 1)
    shown = np.s_[middle - near : middle + near + 1]
    levels = np.round(255 * statistics.correlation[shown, shown].clip(0, 1)).astype(np.uint8)
    end = near + 0.5
    axes.image(colour_table("magma")[levels], (-end, end, end, -end))
    if assessment is not None:
        for k, place in enumerate(assessment.displacements):
            centre = k == len(assessment.displacements) // 2
            x, y = place.T
            axes.points(x, y, "deepskyblue" if centre else "steelblue", 3.5 if centre else 1.5)
    return axes.picture()


def _along(statistics: PatternStatistics) -> Image.Image:
    farthest = len(statistics.correlation) // 2
    lags, middle = np.arange(farthest + 1), statistics.correlation
    title = "autocorrelation along an axis; what stays are lines"
    axes = Axes(ANALYSIS_SIZE, title, Scale(0, min(farthest, FARTHEST_LAG)), Scale(-0.2, 1.02), "lag (px)")
    axes.level(CORRELATION_LENGTH_LEVEL)
    curves = {"x": middle[farthest, farthest:], "y": middle[farthest:, farthest]}
    for (name, along), far, colour in zip(curves.items(), statistics.lengths, COLOURS[:2], strict=True):
        axes.line(lags, along, colour, f"along {name}: {far:.1f} px", dots=True)
    return axes.picture()


def _over_time(in_time: Array) -> Image.Image:
    x, y = Scale(0, max(len(in_time) - 1, 1)), Scale(min(0.0, float(in_time.min())) - 0.02, 1.05)
    axes = Axes(ANALYSIS_SIZE, "autocorrelation from frame to frame", x, y, "frames apart")
    axes.level(STABILITY_LEVEL)
    axes.line(np.arange(len(in_time)), in_time, COLOURS[0], dots=True)
    return axes.picture()
