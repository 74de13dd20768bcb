"""Deconvolution: a scene without the blur of the optics, of defocus or of a moving camera."""

from __future__ import annotations

import torch

from deepir.effects.noise import start_precision
from deepir.errors import ConfigError
from deepir.estimation.cross_validation import WeightSearch, fraction_for_weights
from deepir.estimation.prior_weight import weigh_scene
from deepir.estimation.psf_from_spectrum import fit_psf, spectral_noise
from deepir.fields.psf import PSF, Airy, Defocus, Gaussian, MotionBlur, Simplex
from deepir.messages import Message
from deepir.optim.objective import hold_out
from deepir.problem import Problem
from deepir.problems.initial_estimate import initial_estimate, start_scene
from deepir.problems.recipe import MIN_LOG2_WEIGHT, TRIAL_ITERATIONS, Recipe
from deepir.registry import register
from deepir.schedule import Schedule, Stage, Step

MAX_PSF_EDGE = 0.1  # of a point-spread function, at the rim of its array, relative to its peak
MIN_SPECTRAL_NOISE = 0.1  # relative to the noise between pixels: below, the spectrum is of a sharp frame
MIN_PSF_WIDTH = 0.5  # px: sharp frames give widths up to 0.45, those with a blur of 0.5 px 0.52 to 0.64
MAX_STILL_MOTION = 0.5  # px: a burst at rest moves by less


@register("problem", "deconv")
class Deconv(Recipe):
    """A sharp scene from one frame or a burst, with a point-spread function that is known or not.

    One with a width is found from the frames' spectrum, and held: together with the scene it would go to none. How
    strong the scene's prior is to be, held-out samples say. Gain and offset are estimated where the frames move.
    """

    sensor_weight = 0.2
    operators = ("blur",)
    effect_names = (
        *("saturation", "bad_pixels", "frame_gain", "frame_offset", "line_noise", "noise"),
        *("sensor_pattern", "shading", "outliers"),
    )
    search = WeightSearch(first=0.0, least=MIN_LOG2_WEIGHT, iterations=TRIAL_ITERATIONS, restart=True)
    weigh = staticmethod(search.weigh)

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise, blur and pattern as the raw frames show them; scene: registered average."""
        self.messages = hold_sensor(problem)
        start_precision(problem)
        self.messages += start_psf(problem)
        demand_room(problem)
        if problem.closed_form():
            initial_estimate(problem, self.effects)
        else:
            start_noise(problem)
            start_scene(problem)
        hold_out(problem, seed, fraction_for_weights(problem))
        weigh_scene(problem, self.sensor_weight)
        self.search.start(problem)

    def plan(self, problem: Problem) -> Schedule:
        """The sensor, if it is free, under a weak prior on the scene; the scene's weights; the scene."""
        free, eliminate = self.split(problem)
        sharp = "scene" in free  # else it is a target that is known, of which any blur can be found
        held = psf_names(problem) if sharp else ()
        free = tuple(name for name in free if name not in held)
        still = (Step(tuple(name for name in free if name != problem.motion_unknown())), *eliminate)
        sensor = [
            Stage("sensor 1", still, 40),
            Stage("sensor 2", still, 40, prepare=self.update),
            Stage("sensor 3", (Step(free), *eliminate), 40, prepare=self.update),
        ]
        start = sensor if eliminate else [Stage("start", still, 40)]
        scene = (Step(("scene",)),) if sharp else still
        last = Stage("scene", scene, 120, prepare=self.finish, use_held_out=True)
        return Schedule([*start, *self.search.stages(problem), last])

    def finish(self, problem: Problem) -> None:
        """Hyperparameters, and the scene from its start again."""
        if len(problem.data) > 1:  # in one frame, edges that the prior rounds misfit as defects do
            super().finish(problem)
        else:
            self.weigh(problem)
        self.search.reset(problem)


def psf_names(problem: Problem) -> list[str]:
    """The unknowns that are bound to a blur."""
    return [name for slot, name in problem.slots.items() if slot.rpartition(".")[2] == "psf"]


@torch.no_grad()
def hold_sensor(problem: Problem) -> list[str]:
    """Leave gain and offset as they are where the frames do not move, and say so: a scene would explain any pattern."""
    closed = problem.closed_form()
    motion = problem.values().get(problem.motion_unknown())
    if not closed or (motion is not None and float((motion - motion[:1])[:, :2, 2].abs().max()) >= MAX_STILL_MOTION):
        return []
    for name in closed:
        problem.fields[name].requires_grad_(False)
    few = "one frame does not" if len(problem.data) == 1 else "the frames do not move, and so do not"
    return [
        Message(
            "sensor-left-neutral",
            f"{few} separate the sensor's pattern from the scene: {' and '.join(closed)} are left neutral. "
            "Correct the frames first, or give a burst that moves by 3 to 10 px",
        )
    ]


def start_psf(problem: Problem) -> list[str]:
    """Find each free point-spread function from the spectrum of the frames; one of any shape as the likeliest kind.

    Of frames without a scene, or sharp ones, the spectrum gives no width: the least is taken then, with a message.
    """
    frames, usable = problem.data, problem.precision > 0
    messages: list[str] = []
    for name in psf_names(problem):
        field = problem.fields[name]
        if name not in problem.free() or field.shape[0] > 1:  # frames of several blurs have no one spectrum
            continue
        if isinstance(field, PSF):
            fit_psf(field, frames, usable)
            if cut_off(field):
                field.load_state_dict(next(field.search_starts()))
                slot = next(slot for slot, unknown in problem.slots.items() if unknown == name)
                messages.append(
                    Message(
                        "blur-width-unknown",
                        f"the frames' spectrum does not show how wide the blur is: next to none is taken out. Give its "
                        f"width, with physics.{slot}.fixed=true, or a larger radius",
                    )
                )
            elif (width := float(field.width.detach())) < MIN_PSF_WIDTH:
                messages.append(
                    Message(
                        "blur-small",
                        f"hardly any blur is found (a width of {width:.2g} px): there is little to take away, "
                        "and what is fine in a frame that is sharp may be taken for noise. Of a burst take problem "
                        "'nuc'",
                    )
                )
        elif isinstance(field, Simplex):
            size = (int(frames.shape[-2]), int(frames.shape[-1]))
            found = [kind(field.shape, size=size).to(frames) for kind in (Gaussian, Airy, Defocus, MotionBlur)]
            best = min(found, key=lambda each: fit_psf(each, frames, usable))
            field.init_from(best().detach())
    return messages


def start_noise(problem: Problem) -> None:
    """Set the noise of frames without a pattern to what the blur does not let through: a texture looks like noise."""
    names, usable = psf_names(problem), problem.precision > 0
    if problem.noise is not None or len(names) != 1:
        return
    seen = float(problem.precision[usable].median().rsqrt())
    noise = spectral_noise(problem.fields[names[0]]().detach(), problem.data, usable)
    if noise > MIN_SPECTRAL_NOISE * seen:
        problem.precision.copy_(usable / noise**2)


@torch.no_grad()
def cut_off(field: PSF) -> bool:
    """Whether a point-spread function reaches beyond its array."""
    psf = field()[0, 0]
    return float(max(psf[0].max(), psf[:, 0].max())) > MAX_PSF_EDGE * float(psf.max())


@torch.no_grad()
def demand_room(problem: Problem) -> None:
    """Raise `ConfigError` for a point-spread function that its array cuts off."""
    for slot, name in problem.slots.items():
        field = problem.fields[name]
        if isinstance(field, PSF) and cut_off(field):
            radius = field.shape[-1] // 2
            wider = f"physics.{slot.rpartition('.')[0]}.radius={2 * max(radius, 2)}"
            raise ConfigError(
                f"physics.{slot}: a width of {float(field.width.max()):.3g} px does not fit into a radius of "
                f"{radius} px from the centre; take {wider}"
            )
