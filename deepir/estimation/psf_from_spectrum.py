"""Point-spread function from the power spectrum of the frames.

Power spectra of natural scenes fall as a power of the frequency, of about 2.4; a blur falls faster, and the
noise is flat. The width of maximum likelihood therefore needs no scene. (A joint estimate with a sparse prior
prefers a blurred scene and a sharp lens: Levin et al. 2009, "Understanding and evaluating blind deconvolution
algorithms".)

Source: Field 1987; Burton and Moorhead 1987; likelihood of Whittle 1953.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Callable

import torch
from torch import Tensor, nn

from deepir.arrays.windows import fill_nearest
from deepir.fields.psf import PSF

SPECTRAL_EXPONENT = 2.4  # mean exponent of the power spectrum of natural scenes (Field 1987, Burton and Moorhead 1987)
SPECTRAL_EXPONENT_SIGMA = 0.13  # standard deviation of that exponent in the prior
#: Lowest frequency that is used, radians per px: below, few waves represent large shapes of the scene.
MIN_FREQUENCY = 0.15
N_REFINED_STARTS = 3  # starting points from which the likelihood is maximised
MAX_REFINEMENT_ITERATIONS = 40  # most iterations of a maximisation


def fit_psf(field: PSF, frames: Tensor, usable: Tensor) -> float:
    """Fit the parameters of a point-spread function by maximum likelihood; the negative log-likelihood, nats.

    From frames (N, 1, h, w) without the fixed pattern. Samples that are not usable are filled by the nearest.
    """
    misfit, trial = _WhittleLikelihood(fill_nearest(frames, usable)), copy.deepcopy(field).double()
    # The likelihood has several optima in the width, so that it is asked at many first, and followed from the best.
    starts = sorted(trial.search_starts(), key=lambda start: _minimise_from(misfit, trial, start, []))
    ends = []
    for start in starts[:N_REFINED_STARTS]:
        loss = _minimise_from(misfit, trial, start, list(trial.parameters()))
        ends.append((loss, copy.deepcopy(trial.state_dict())))
    loss, state = min(ends, key=lambda end: end[0])
    field.load_state_dict(state)
    return loss


def spectral_noise(psf: Tensor, frames: Tensor, usable: Tensor) -> float:
    """Standard deviation of the noise behind a known blur, from the flat part of the spectrum.

    Unlike texture, which resembles noise between pixels, noise does not pass through the blur. The point-spread
    function is (1, 1, n, n); frames and usable samples are (N, 1, h, w), without the fixed pattern.
    """
    misfit = _WhittleLikelihood(fill_nearest(frames, usable))
    noise = _minimise(misfit, lambda: misfit.response(psf.double()), [])[1][2]
    return math.sqrt(misfit.unit * math.exp(noise))


class _WhittleLikelihood:
    """Negative logarithm of Whittle's likelihood of the spectrum.

    The power of a wave is exponentially distributed about `A f^-p |pixel|² |psf|² + noise`.
    """

    def __init__(self, frames: Tensor) -> None:
        power, y, x = periodogram(frames)
        self.size = (int(frames.shape[-2]), int(frames.shape[-1]))
        squared = y**2 + x**2
        # Lines along the axes are the sensor's rows and columns.
        self.used = (squared > MIN_FREQUENCY**2) & (y != 0) & (x != 0)
        self.unit = float(power[self.used].median())
        self.power, self.logarithm = power[self.used] / self.unit, squared[self.used].log()
        self.pixel = (torch.sinc(y / (2 * math.pi)) * torch.sinc(x / (2 * math.pi)))[self.used].square()

    def response(self, psf: Tensor) -> Tensor:
        """Squared frequency response of pixels behind a point-spread function (1, 1, n, n)."""
        blur = torch.fft.rfft2(psf[0, 0], s=self.size)[self.used]
        return self.pixel * (blur.real.square() + blur.imag.square())

    def __call__(self, response: Tensor, scene: Tensor) -> Tensor:
        amplitude, slope, noise = scene
        expected = response * torch.exp(amplitude - slope / 2 * self.logarithm) + noise.exp()
        return (expected.log() + self.power / expected).sum() + (
            (slope - SPECTRAL_EXPONENT) / SPECTRAL_EXPONENT_SIGMA
        ) ** 2 / 2


def _minimise_from(misfit: _WhittleLikelihood, field: PSF, start: dict[str, Tensor], free: list[nn.Parameter]) -> float:
    """Minimum over spectrum, noise and the free parameters of the field, from a start."""
    field.load_state_dict(start)
    return _minimise(misfit, lambda: misfit.response(field()), free)[0]


def _minimise(
    misfit: _WhittleLikelihood, response: Callable[[], Tensor], free: list[nn.Parameter]
) -> tuple[float, list[float]]:
    """Minimum over spectrum, noise and `free`; and log amplitude, exponent and log noise at it."""
    scene = torch.tensor(
        [0.0, SPECTRAL_EXPONENT, -1.0], dtype=torch.float64, device=misfit.power.device
    ).requires_grad_()
    optimiser = torch.optim.LBFGS([*free, scene], max_iter=MAX_REFINEMENT_ITERATIONS, line_search_fn="strong_wolfe")
    with torch.no_grad():
        known = None if free else response()

    def evaluate() -> Tensor:
        optimiser.zero_grad()
        loss = misfit(response() if known is None else known, scene)
        loss.backward()
        return loss

    optimiser.step(evaluate)
    loss = float(evaluate().detach())
    return (loss if math.isfinite(loss) else math.inf), scene.tolist()


def periodogram(frames: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Periodogram of the periodic component of frames (N, 1, h, w), which has no steps at the borders.

    Mean power (h, w / 2 + 1), and frequencies along y and x, radians per px; float64.

    Source: Moisan 2011, "Periodic plus smooth image decomposition".
    """
    frames = frames[:, 0].double()
    _, height, width = frames.shape
    step = torch.zeros_like(frames)
    step[:, 0] += frames[:, -1] - frames[:, 0]
    step[:, -1] += frames[:, 0] - frames[:, -1]
    step[:, :, 0] += frames[:, :, -1] - frames[:, :, 0]
    step[:, :, -1] += frames[:, :, 0] - frames[:, :, -1]
    y = 2 * math.pi * torch.fft.fftfreq(height, dtype=torch.float64, device=frames.device)[:, None]
    x = 2 * math.pi * torch.fft.rfftfreq(width, dtype=torch.float64, device=frames.device)
    laplacian = 2 * y.cos() + 2 * x.cos() - 4
    laplacian[0, 0] = 1
    smooth = torch.fft.rfft2(step) / laplacian
    return (torch.fft.rfft2(frames) - smooth).abs().square().mean(0) / (height * width), y, x
