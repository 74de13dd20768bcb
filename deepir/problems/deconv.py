"""Deconvolution: a scene without the blur of the optics, of defocus or of a moving camera."""

from __future__ import annotations

import torch

from deepir.cross_validation import begin_smooth, start_trials, trials, weigh_by_trials
from deepir.priors.psf import PSF
from deepir.problem import Problem
from deepir.problems.definition import Definition, start_precision, start_scene
from deepir.registry import register
from deepir.slow_strengths import estimate_slow
from deepir.solve import Stage, Step
from deepir.spectrum import fit_psf
from deepir.strengths import HELD_OUT as LEAST
from deepir.strengths import hold_out, keep_gauge, start_parts, update_noise, update_parts, weigh_scene

#: Weight of the scene's penalties while the sensor is estimated, to that of the scene's own stage.
WEAK = 0.2
#: Share of a frame's samples, in all frames together, that is held out: what a blur leaves of detail, few do not tell.
HELD_OUT = 0.1
ITERATIONS = 40  # of a trial: through a blur, detail comes slowly


@register("problem", "deconv")
class Deconv(Definition):
    """A sharp scene from one frame or a burst, with a point-spread function that is known or not.

    One with a width is found from the frames' spectrum, and held: together with the scene it would go to none. How
    strong the scene's prior is to be, held-out samples say. Gain and offset are estimated where the frames move.
    """

    operators = ("blur",)
    weigh = staticmethod(weigh_by_trials)

    def initialise(self, problem: Problem, seed: int) -> None:
        """Noise, blur and pattern as the raw frames show them; scene: registered average."""
        self.messages = hold_sensor(problem)
        start_precision(problem)
        start_psf(problem)
        start_scene(problem)
        if problem.closed_form():
            start_parts(problem)
            estimate_slow(problem, start=True)
        hold_out(problem, seed, max(LEAST, HELD_OUT / len(problem.data)))
        weigh_scene(problem, WEAK)
        start_trials(problem, afresh=True)

    def plan(self, problem: Problem) -> list[Stage]:
        """The sensor, if it is free, under a weak prior on the scene; the scene's weights; the scene."""
        closed = tuple(problem.closed_form())
        eliminate = (Step(closed, "eliminate"),) if closed else ()
        held = {*closed, *psf_names(problem)}
        free = tuple(name for name in problem.free() if name not in held)
        still = (Step(tuple(name for name in free if name != "motion")), *eliminate)
        sensor = [
            Stage("sensor 1", still, 40),
            Stage("sensor 2", still, 40, prepare=_update),
            Stage("sensor 3", (Step(free), *eliminate), 40, prepare=_update),
        ]
        return [
            *(sensor if closed else [Stage("scene 1", still, 40)]),
            *trials(problem, first=0.0, iterations=ITERATIONS),
            Stage("scene", (Step(("scene",)),), 120, prepare=_finish, use_held_out=True),
        ]


def psf_names(problem: Problem) -> list[str]:
    """The unknowns that are bound to a blur."""
    return [name for slot, name in problem.slots.items() if slot.rpartition(".")[2] == "psf"]


@torch.no_grad()
def hold_sensor(problem: Problem) -> list[str]:
    """Leave gain and offset neutral where the frames do not move: one scene explains any pattern then; and say so."""
    closed = problem.closed_form()
    motion = problem.values().get("motion")
    if not closed or (motion is not None and len(motion) > 1 and not torch.allclose(motion, motion[:1], atol=0.5)):
        return []
    for name in closed:
        problem.fields[name].requires_grad_(False)
    return []


def start_psf(problem: Problem) -> None:
    """Find each point-spread function that has a width and is free from the spectrum of the frames."""
    for name in psf_names(problem):
        field = problem.fields[name]
        if isinstance(field, PSF) and name in problem.free():
            fit_psf(field, problem.data, problem.precision > 0)


def _update(problem: Problem) -> None:
    update_noise(problem)
    keep_gauge(problem)
    update_parts(problem)
    weigh_by_trials(problem, WEAK)


def _finish(problem: Problem) -> None:
    if len(problem.data) > 1:  # in one frame, edges that the prior rounds misfit as defects do
        update_noise(problem, settled=True)
    weigh_by_trials(problem)
    begin_smooth(problem)
