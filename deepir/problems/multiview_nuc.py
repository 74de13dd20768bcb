"""Non-uniformity correction of frames of different scenes."""

from __future__ import annotations

from collections.abc import Sequence

import torch
import torch.nn.functional as F
from torch import Tensor

from deepir.arrays.statistics import noise_in_flat_windows
from deepir.arrays.windows import median_filter
from deepir.closed_form.variable_projection import PIXEL
from deepir.errors import ConfigError, DataError
from deepir.estimation.prior_weight import weigh_scene
from deepir.fields.sensor_maps import GaussianMap
from deepir.fields.shading import Shading
from deepir.messages import Message
from deepir.multiview.low_order_pattern import is_implausible, low_order_part, low_order_pattern
from deepir.multiview.pattern import find_pattern, frame_gains, is_at_rest, shrink_shading
from deepir.problem import Problem
from deepir.problems.initial_estimate import start_scene
from deepir.problems.recipe import Recipe
from deepir.registry import register
from deepir.schedule import Schedule, Stage, Step

MIN_FRAMES_FOR_PIXELS = 4  # frames; of fewer, pixels are hardly separated from the scenes
BLOCK = 8  # px, of which means are compared
SIMILARITY = 0.3  # mean squared differences of frames, to those of unrelated ones
GUESS = 0.1  # share of the low-order part, from none and from all, within which its division is no guess
CONTRAST_ROUNDS = 3  # of gains of the frames, and of the pattern that they share
DEFECTIVE, ISOLATED = 3.0, 1.5  # misfit of a pixel that is no sensor: nats, and times that of its neighbourhood


@register("problem", "multiview_nuc")
class MultiviewNUC(Recipe):
    """The scene of each frame, and the gain and offset that all frames share; nothing is registered.

    (The setting of Barral, Arias and Davy 2024, "Fixed pattern noise removal for multi-view single-sensor infrared
    camera".) The sensor is found from the gradients of all frames together, then each scene with the sensor fixed.
    """

    frames = 2
    judged = True
    operators = ("sensor",)
    effect_names = ("frame_gain", "frame_offset")

    def initialise(self, problem: Problem, seed: int) -> None:
        """The sensor, from the frames alone, the noise that it leaves, and the scenes as they then look.

        Raises:
            DataError: The camera stands still.
        """
        device = problem.data.device
        problem.to("cpu")  # the pattern is found there
        frames, usable = problem.data[:, 0], problem.precision[:, 0] > 0
        self.messages = _demand_different(frames, usable)
        gain, offset = (_parts(problem, slot) for slot in ("gain", "offset"))
        edges, pattern, low_order = find_pattern(frames, usable, gain, offset)
        for _ in range(CONTRAST_ROUNDS if problem.noise is None else 0):
            gains = frame_gains(frames, usable, pattern[1])
            if gains is None:
                break
            problem.divide_frames(gains)
            frames = problem.data[:, 0]
            edges, pattern, low_order = find_pattern(frames, usable, gain, offset)
        misfit = edges.misfit(pattern)
        isolated = misfit > ISOLATED * median_filter(misfit[None, None])[0, 0]
        usable = usable & ~((misfit > DEFECTIVE) & isolated)
        self.messages += _divide_low_order_part(problem, low_order, offset, usable)
        if problem.noise is not None:
            problem.precision.mul_(usable[:, None])
        else:
            noise = noise_in_flat_windows(_corrected(problem), usable)
            problem.precision.copy_(usable[:, None] / max(noise, 1e-4 * float(frames[usable].std())) ** 2)
        start_scene(problem)
        weigh_scene(problem)
        problem.to(device)

    def plan(self, problem: Problem) -> Schedule:
        """The scenes, with the sensor fixed.

        Raises:
            ConfigError: All frames share a scene; gain and offset are no sums of parts, or both are known.
        """
        if problem.fields["scene"].shape[0] < len(problem.data):
            raise ConfigError(
                "scene.shared: 'multiview_nuc' is for frames of different scenes, scene.shared=false; "
                "frames of one scene are for 'nuc'"
            )
        gain, offset = (_parts(problem, slot) for slot in ("gain", "offset"))
        if not (gain or offset):
            raise ConfigError("physics.sensor: gain and offset are both known; take problem=generic")
        return Schedule([Stage("scene", (Step(("scene",)),), 40)])


def _demand_different(frames: Tensor, usable: Tensor) -> list[str]:
    """Messages for frames (N, h, w) that are few, or much alike; `DataError` if they show all the same."""
    if is_at_rest(frames.cpu().numpy(), usable.cpu().numpy()):
        raise DataError(
            "the frames all show the same, from a camera at rest: what stands still in all of them is taken for the "
            "sensor's pattern. Take frames of different scenes, or move the camera and take problem 'nuc'"
        )
    means = F.avg_pool2d(frames[:, None], BLOCK)[:, 0]
    means = means - means.mean((1, 2), keepdim=True)
    others = means.roll(len(means) // 2, 0)
    unrelated = means.square().mean((1, 2)) + others.square().mean((1, 2))
    apart = float(((means - others).square().mean((1, 2)) / unrelated.clamp(min=1e-30)).median())
    messages: list[str] = []
    if apart < SIMILARITY:
        messages.append(
            Message(
                "frames-alike",
                f"the frames are much alike (they differ by {apart:.0%} of what unrelated ones do): what they all "
                "show at one place is taken for the pattern. Take frames further apart, data.frames=::10, or problem "
                "'nuc'",
            )
        )
    if len(frames) < MIN_FRAMES_FOR_PIXELS:
        messages.append(
            Message(
                "few-frames",
                f"{len(frames)} frames: what each pixel has of its own is hardly separated from the scenes. "
                f"Take {MIN_FRAMES_FOR_PIXELS}, better 10",
            )
        )
    return messages


def _parts(problem: Problem, slot: str) -> Sequence[GaussianMap]:
    """The parts of the sensor's gain or offset; none if it is known."""
    unknown = problem.sensor_unknowns()[slot]
    if unknown not in problem.free():
        return ()
    parts = problem.fields[unknown].parts()
    if not parts or (slot == "gain" and any(isinstance(part, Shading) for part in parts)):
        raise ConfigError(
            f"physics.sensor.{slot}: 'multiview_nuc' finds sums of column, row, pixel and, in the offset, shading"
        )
    return parts


@torch.no_grad()
def _divide_low_order_part(
    problem: Problem, low_order: Shading, offset: Sequence[GaussianMap], usable: Tensor
) -> list[str]:
    """Divide the shared low-order part between the offset's shading and the scenes; a message where that is a guess.

    Neighbouring frames that show the same things displaced decide, else how much the scenes differ.
    """
    shading = next((part for part in offset if isinstance(part, Shading)), None)
    if shading is None or shading.sigma_is_fixed:
        return []
    scenes = _corrected(problem)
    rest = low_order.values[0, 0]
    moved = low_order_pattern((scenes - rest).double().cpu().numpy(), usable.cpu().numpy())
    messages: list[str] = []
    if moved is not None:
        rest = rest + torch.from_numpy(moved).to(rest)
    else:
        share = shrink_shading(low_order, scenes - rest)
        rest = low_order.values[0, 0]
        if GUESS < share < 1 - GUESS:
            messages.append(
                Message(
                    "shading-guessed",
                    "no two frames show the same things, so the sensor's shading is separated from slopes of the "
                    f"scenes only by how much these differ: {share:.0%} of what all frames share is taken for the "
                    "sensor's. Take neighbouring frames of a moving camera",
                )
            )
    before = problem.values()[problem.sensor_unknowns()["offset"]][0, 0]
    found, known = (before + rest).double().cpu().numpy(), usable.any(0).cpu().numpy()
    if is_implausible(found, known):
        rest = rest - torch.from_numpy(low_order_part(found, known)).to(rest)
        messages = [
            Message(
                "shading-implausible",
                "the shading that all frames share is implausibly strong for a sensor's pattern, by its fine "
                "part: it is left to the scenes. Take frames of different scenes, and of a camera that turns",
            )
        ]
    shading.sigma.copy_(rest.std())
    for part in (shading, *(part for part in offset if part.constant_axes == PIXEL and part is not shading)):
        before = part.values[0, 0]
        part.assign(part.values + rest)
        rest = rest - (part.values[0, 0] - before)
    return messages


def _corrected(problem: Problem) -> Tensor:
    """The frames without the sensor's pattern, (N, h, w)."""
    values, unknowns = problem.values(()), problem.sensor_unknowns()
    gain, offset = values[unknowns["gain"]], values[unknowns["offset"]]
    return ((problem.data - offset) / gain)[:, 0]
