"""Problems and components on a device: `python on_card.py [cuda]`, without a name on that of `pretended_card`.

Prints one line of JSON for each: its kind and name, and its difference from the CPU or its error. A process of its own,
as torch must know a pretended device before the first gradient.
"""

import contextlib
import copy
import json
import sys
import traceback

import pretended_card
import torch
from pretended_card import Card
from small_problems import PROBLEMS, difference, solved

from deepir.kernels import threads
from deepir.problems import deblur_lag, optical_flow
from deepir.registry import components

DEVICE = sys.argv[1] if __name__ == "__main__" and len(sys.argv) > 1 else "card"
on_device = Card if DEVICE == "card" else contextlib.nullcontext
#: Torch's thread for the pretended device ends at the gradient of an index: the interpolation of `radial`.
LEFT_OUT = {"radial", "wavelets", "ffdnet"}  # the last two need extras


def problem(name):
    """A whole solve, from the registered frames to the figures of the result."""
    wanted = solved(name)
    with on_device():
        return difference(solved(name, f"device={DEVICE}"), wanted)


def operator(name):
    operator, x, slots = components("operator")[name].example()

    def evaluate(device):
        stage, given = operator.to(device), {slot: value.to(device) for slot, value in slots.items()}
        there = x.to(device).requires_grad_()
        y = stage(there, **given)
        gradient = torch.autograd.grad(y.square().sum(), there)[0]
        return [y, gradient, stage.adjoint(y.detach(), x.shape, **given), stage.valid(torch.ones_like(there), **given)]

    return both(evaluate)


def field(name):
    field = components("field")[name].example()

    def evaluate(device):
        there = copy.deepcopy(field).to(device)
        value = there()
        loss = value.square().sum() + (0 if (prior := there.penalty()) is None else prior)
        parameters = list(there.parameters())
        found = torch.autograd.grad(loss, parameters, allow_unused=True) if loss.requires_grad else []
        there.init_from(value.detach())
        return [value, there(), *(each for each in found if each is not None)]

    return both(evaluate)


def penalty(name):
    penalty = components("penalty")[name].example()
    picture = torch.rand(1, 1, 7, 9, generator=torch.Generator().manual_seed(0))

    def evaluate(device):
        there, value = copy.deepcopy(penalty).to(device), picture.to(device).requires_grad_()
        with torch.no_grad():
            there.adapt(value.detach(), 0.1)
        energy = there(value)
        figures = [*there.mean_curvature(value.detach()), there.fraction_shrunk_to_zero(value.detach())]
        return [energy, torch.autograd.grad(energy, value)[0], torch.tensor(figures)]

    return both(evaluate)


def fidelity(name):
    drawn = torch.rand(3, 2, 1, 7, 9, generator=torch.Generator().manual_seed(0))

    def evaluate(device):
        prediction, data, precision = (each.to(device) for each in drawn.unbind())
        prediction.requires_grad_()
        nats = components("fidelity")[name]()(prediction, data, precision)
        return [nats, torch.autograd.grad(nats, prediction)[0]]

    return both(evaluate)


def denoiser(name):
    picture = torch.rand(1, 1, 24, 24, generator=torch.Generator().manual_seed(0))

    def evaluate(device):
        return [components("denoiser")[name](picture.to(device), 0.1)]

    return both(evaluate)


def both(evaluate):
    """The largest difference of what is evaluated on both devices."""
    wanted = [each.detach() for each in evaluate("cpu")]
    with on_device():
        found = evaluate(DEVICE)
        off = [each for each in found[:2] if each.device.type != DEVICE]
        if off:
            raise RuntimeError(f"a tensor {tuple(off[0].shape)} came out on the CPU")
        pairs = zip([each.detach().cpu() for each in found], wanted, strict=True)
        return max(float((a - b).nan_to_num().abs().max()) for a, b in pairs if a.numel())


EVALUATED = (problem, operator, field, penalty, fidelity, denoiser)


def names_of(kind):
    """Problems or components of a kind that are evaluated."""
    return list(PROBLEMS) if kind == "problem" else [name for name in components(kind) if name not in LEFT_OUT]


def main():
    if DEVICE == "card":
        pretended_card.install()
    torch.backends.cudnn.allow_tf32 = False  # rounding errors of float32, as on the CPU
    threads.ENABLED = False  # so that the CPU takes the same operations
    torch.set_num_threads(1)
    deblur_lag.TRIAL_ITERATIONS = optical_flow.LEVEL_ITERATIONS = 1  # the same steps, less often
    for evaluate in EVALUATED:
        kind = evaluate.__name__
        for name in names_of(kind):
            try:
                found = {"difference": evaluate(name)}
            except Exception:  # each names itself
                found = {"error": traceback.format_exc(limit=-4)}
            print(json.dumps({"kind": kind, "name": name, **found}), flush=True)


if __name__ == "__main__":
    main()
