"""The likelihood of shifts between frames, by cross-correlation."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np
import torch
from scipy.optimize import minimize
from torch import Tensor

from deepir.operators.motion_models import rotation
from deepir.registration.preprocess import Level, sample

if TYPE_CHECKING:
    from deepir.registration.block_likelihood import RotationLikelihood

SEARCH_ANGLES = [math.radians(a) for a in (0, -2, 2, -4, 4, -6, 6, -8, 8)]  # radians
#: Ratio by which the peak of a rotated frame must exceed the best one before it. Among several low peaks (depth, plain
#: scenes) the highest exceeds the others by 1 to 3 % by chance.
ROTATION_MARGIN = 1.08
WHITENING_EXPONENT = 0.7  # 0: cross-correlation, 1: phase correlation
BAND_SIGMA = 0.12  # cycles per px of the level; Gaussian band in which spectra are correlated
MAX_WAVENUMBER = 2.5  # rad per px; the likelihood uses no shorter waves, which hold almost no scene
N_RINGS = 14  # rings of waves of about one length, each with one power of scene and one of noise
#: Height of a correlation peak, in standard deviations over all lags, at which two frames match: per root of the number
#: of pixels, and its bounds. Frames of other scenes seldom reach the larger one, those of one scene reach 11 and more.
PEAK_PER_ROOT_PIXEL, PEAK_BOUNDS = 0.12, (4.5, 8.0)


def correlation_search(images: Tensor, level: Level, model: str, pattern_present: bool) -> tuple[Tensor, Tensor]:
    """Register all images `(N, h, w)` to the one that most of them match, the first of these.

    Arguments as `match_to_reference`. Returns motions `(N, 3, 3)` relative to the reference, and match scores `(N,)`:
    height of the peak over the detection threshold, infinite for the reference itself.
    """
    candidates, found = list(range(len(images))), []
    for _ in range(4):  # references at most
        reference = candidates[0]
        motion, match_score = match_to_reference(images[reference], images, level, model, pattern_present)
        motion[reference], match_score[reference] = torch.eye(3, dtype=torch.float64), math.inf
        found.append((motion, match_score))
        candidates = [k for k in candidates if not match_score[k] > 1]
        if not candidates or 2 * (match_score > 1).sum() > len(images):
            break
    return max(found, key=lambda each: int((each[1] > 1).sum()))


def match_to_reference(
    reference: Tensor, images: Tensor, level: Level, model: str, pattern_present: bool
) -> tuple[Tensor, Tensor]:
    """Register images to a reference: highest correlation peak over all shifts and rotations.

    Args:
        reference: `(h, w)`.
        images: `(N, h, w)`.
        level: their level.
        model: "shift" searches shifts only; any other model searches rotations, too.
        pattern_present: True if the images contain the fixed pattern.

    Returns:
        Motions `(N, 3, 3)`, accurate to a pixel of the level, and match scores `(N,)`.
    """
    h, w = reference.shape
    spectra = torch.fft.rfft2(images * hann_window(h, w)).conj()
    angles = SEARCH_ANGLES[:1] if model == "shift" else SEARCH_ANGLES
    best_motion = torch.eye(3, dtype=torch.float64).repeat(len(images), 1, 1)
    best_height = torch.zeros(len(images))
    for k, turn in enumerate(rotation(torch.tensor(angles, dtype=torch.float64))):
        rotated, _ = sample(reference[None], turn[None], level)
        surface = whitened_correlation(rotated[0], spectra, pattern_present)
        peak, index = surface.flatten(1).max(1)
        height = peak / surface.std((1, 2)).clamp_min(1e-20)
        # frame(p) = reference(turn (p + lag)): the lag is in the axes of the rotated reference
        lag = torch.stack(((index % w + w // 2) % w - w // 2, (index // w + h // 2) % h - h // 2), -1)
        motion = turn.repeat(len(images), 1, 1)
        motion[:, :2, 2] = lag.double() * level.factor @ turn[:2, :2].T
        improved = height > best_height * (ROTATION_MARGIN if k else 1.0)
        best_motion[improved], best_height[improved] = motion[improved], height[improved]
    threshold = float(np.clip(PEAK_PER_ROOT_PIXEL * (h * w) ** 0.5, *PEAK_BOUNDS))
    return best_motion, best_height.double() / threshold


def hann_window(h: int, w: int) -> Tensor:
    """Hann window `(h, w)`: a taper against the edges of the frame."""
    return torch.hann_window(h, periodic=False)[:, None] * torch.hann_window(w, periodic=False)


def whitened_correlation(reference: Tensor, spectra: Tensor, pattern_present: bool) -> Tensor:
    """Partly whitened, band-limited cross-correlation of a reference with images.

    The fixed pattern correlates with itself at lag zero, its lines along the axes; the correlation of a scene is smooth
    there. So with a pattern the lags along both axes are replaced by the mean of their neighbours before whitening.

    Of a reference `(h, w)` and the conjugate spectra `(N, h, w / 2 + 1)` of the tapered images it is `(N, h, w)`, lag
    zero at [0, 0].

    Source: Knapp and Carter, The generalized correlation method, IEEE Trans. ASSP 24 (1976); phase correlation: Kuglin
    and Hines, IEEE Conf. Cybernetics and Society (1975).
    """
    h, w = size = (reference.shape[0], reference.shape[1])
    cross = spectra * torch.fft.rfft2(reference * hann_window(h, w))
    if pattern_present:
        lags = torch.fft.irfft2(cross, s=size)
        lags[:, :, 0] = (lags[:, :, 1] + lags[:, :, -1]) / 2
        lags[:, 0] = (lags[:, 1] + lags[:, -1]) / 2
        cross = torch.fft.rfft2(lags)
    power = cross.abs()
    fy, fx = torch.fft.fftfreq(h)[:, None], torch.fft.rfftfreq(w)
    band = torch.exp(-0.5 * (fy**2 + fx**2) / BAND_SIGMA**2)
    floor = 1e-3 * power.amax((1, 2), keepdim=True) + 1e-20
    return torch.fft.irfft2(band * cross / (power + floor) ** WHITENING_EXPONENT, s=size)


def maximise(likelihood: ShiftLikelihood | RotationLikelihood, parameters: np.ndarray) -> np.ndarray:
    """Parameters `(K, P)` of a local maximum of a likelihood, px: by L-BFGS in turn with estimates of the powers.

    From initial parameters `(K, P)`. The likelihood's powers are changed.
    """
    objective, options = likelihood.negative_log_likelihood, {"maxiter": 20, "gtol": 1.0}  # nats per px
    for _ in range(3):  # alternations at most
        result = minimize(objective, parameters.ravel(), jac=True, method="L-BFGS-B", options=options)
        previous, parameters = parameters, result.x.reshape(parameters.shape)
        if np.abs(parameters - previous).max() < 0.05:  # px
            break
        likelihood.update_powers(parameters)
    return parameters


class ShiftLikelihood:
    """Likelihood of the shifts of all frames but the first, of frames `(N, h, w)`.

    y `(r,)`, x `(c,)`: angular frequencies of the waves used, rad per px. frames: `(N, r, c)`, the spectra. scene,
    noise: `(r, c)`, powers. pattern: power.
    """

    def __init__(self, frames: Tensor) -> None:
        h, w = frames.shape[1:]
        taper = hann_window(h, w).double()
        frames = (frames - (frames * taper).sum((1, 2), keepdim=True) / taper.sum()) * taper
        y, x = (2 * np.pi * waves for waves in (np.fft.fftfreq(h), np.fft.rfftfreq(w)))
        rows, columns = (  # without 2.5 cycles per frame beside the axes, to which the taper spreads lines
            (2.5 * 2 * np.pi / side < np.abs(each)) & (np.abs(each) < MAX_WAVENUMBER) for side, each in ((h, y), (w, x))
        )
        self.y, self.x = y[rows], x[columns]
        self.size, self.band = (h, w), np.ix_(rows, columns)
        spectra = torch.fft.rfft2(frames).numpy() / float(taper.square().sum().sqrt())
        self.frames = np.ascontiguousarray(spectra[:, rows][:, :, columns])
        self.wavenumber = np.hypot(self.y[:, None], self.x)
        self.ring = np.digitize(self.wavenumber, np.geomspace(2 * np.pi / max(h, w), MAX_WAVENUMBER, N_RINGS))
        self.ring_sizes = np.bincount(self.ring.ravel(), minlength=N_RINGS + 1)
        self._set_initial_powers(self.wavenumber > 0.8 * MAX_WAVENUMBER)

    def _set_initial_powers(self, high_band: np.ndarray) -> None:
        """Initial powers: at high frequencies the temporal variance is noise and the rest of the power is pattern."""
        n = len(self.frames)
        power = (np.abs(self.frames) ** 2).mean(0)
        temporal_variance = (np.abs(self.frames - self.frames.mean(0)) ** 2).sum(0) / (n - 1)
        self.noise_floor = 1e-9 * float(power.mean())  # frames may be identical
        noise = max(float(temporal_variance[high_band].mean()), self.noise_floor)
        mean_over_median = 1 / np.log(2)  # of an exponential distribution, which is that of a wave's power
        pattern = max(mean_over_median * float(np.median(power[high_band])) - noise, 0.1 * noise)
        total = np.bincount(self.ring.ravel(), power.ravel(), N_RINGS + 1)
        ring_mean = (total / np.maximum(self.ring_sizes, 1))[self.ring]
        self.scene = np.maximum(ring_mean - pattern - noise, 0.02 * pattern)
        self.pattern, self.noise = pattern, np.full(power.shape, noise)

    def negative_log_likelihood(self, shifts: np.ndarray) -> tuple[float, np.ndarray]:
        """Value in nats, up to a constant, and gradient at shifts `(2 (N - 1),)` in px."""
        from deepir.kernels.shift_likelihood import negative_log_likelihood

        rows = len(self.y)
        values, gradient = np.empty(rows), np.empty((rows, len(self.frames), 2))
        given = self._kernel_arguments(shifts.reshape(-1, 2))
        negative_log_likelihood(0, rows, *given, self.y, self.x, values, gradient)
        return float(values.sum()), gradient.sum(0)[1:].ravel()

    def update_powers(self, shifts: np.ndarray) -> None:
        """Estimate the powers at shifts `(N - 1, 2)` in px by six steps of expectation-maximisation."""
        from deepir.kernels.shift_likelihood import expected_powers

        n, rows = len(self.frames), len(self.y)
        expected, pattern_powers = np.empty((rows, N_RINGS + 1, 2)), np.empty(rows)
        for _ in range(6):
            expected_powers(0, rows, *self._kernel_arguments(shifts), self.ring, expected, pattern_powers)
            scene, noise = (expected.sum(0) / np.maximum(self.ring_sizes, 1)[:, None]).T
            self.scene, self.noise = scene[self.ring], np.maximum(noise / n, self.noise_floor)[self.ring]
            self.pattern = float(pattern_powers.sum()) / self.ring.size

    def _kernel_arguments(self, shifts: np.ndarray) -> tuple[Any, ...]:
        """Arguments of the compiled loops at shifts `(N - 1, 2)`; one call for all rows, too few for threads."""
        x, y = 1j * np.vstack((np.zeros((1, 2)), shifts)).T[:, :, None]
        return self.frames, np.exp(y * self.y), np.exp(x * self.x), self.scene, self.pattern, self.noise


def integer_shifts(frames: Tensor) -> np.ndarray:
    """Most likely integer shifts (x, y) `(N - 1, 2)`, px, of variance-stabilised frames relative to the first.

    By coordinate descent over the frames. Each frame is compared with the placed ones at all shifts d at once. The
    first harmonic, in the phase `k d`, of the pairwise log-likelihood of each wave is summed over waves by a Fourier
    transform: a correlation in which scene, pattern and noise have their weights. Powers keep their initial values. At
    lag zero the pattern matches itself whatever its weight: that lag is excluded.
    """
    likelihood = ShiftLikelihood(frames)
    h, w = likelihood.size
    shifts, is_placed = np.zeros((len(frames), 2), int), np.arange(len(frames)) == 0
    for _ in range(4):  # sweeps at most
        previous = shifts.copy()
        for k in range(1, len(frames)):
            other_frames = is_placed & (np.arange(len(frames)) != k)
            nats = np.fft.irfft2(first_harmonic(likelihood, k, other_frames, shifts), s=(h, w))
            nats[shifts[other_frames, 1], shifts[other_frames, 0]] = np.inf
            y, x = np.unravel_index(nats.argmin(), nats.shape)
            shifts[k] = (x + w // 2) % w - w // 2, (y + h // 2) % h - h // 2
            is_placed[k] = True
        if (shifts == previous).all():
            break
    return shifts[1:].astype(float)


def first_harmonic(likelihood: ShiftLikelihood, k: int, other_frames: np.ndarray, all_shifts: np.ndarray) -> np.ndarray:
    """First harmonic, in the phase of each wave, of the pairwise negative log-likelihood of frame k and other frames.

    The covariance of two frames has the determinant `p - q cos(k d)`. Its logarithm and its inverse are series in
    powers of `ratio`. The harmonic is `(h, w / 2 + 1)` complex, summed over the other frames, `(N,)` bool; zero for
    waves that are not used. Of all shifts (x, y) `(N, 2)`, px, those of the other frames are used.
    """
    scene, pattern, noise = likelihood.scene, likelihood.pattern, likelihood.noise
    cross = 2 * scene * pattern
    rest = noise * (noise + 2 * (scene + pattern))
    root = np.sqrt(rest * (rest + 2 * cross))
    ratio = cross / (rest + cross + root)
    shifts, frame = all_shifts[other_frames], likelihood.frames[k]
    phase_y, phase_x = np.exp(-1j * shifts[:, 1:] * likelihood.y), np.exp(-1j * shifts[:, :1] * likelihood.x)
    phase = phase_y[:, :, None] * phase_x[:, None]
    others = likelihood.frames[other_frames]
    ahead, behind = (others.conj() * phase).sum(0) * frame, (others * phase).sum(0) * frame.conj()
    power = (phase * (np.abs(others) ** 2 + np.abs(frame) ** 2)).sum(0)
    explained = (pattern + scene * ratio) * ratio * ahead + (pattern * ratio + scene) * behind
    values = ((scene + pattern + noise) * ratio * power - explained) / root - ratio * phase.sum(0)
    harmonic = np.zeros((likelihood.size[0], likelihood.size[1] // 2 + 1), complex)
    too_long = likelihood.wavenumber < 0.2  # rad per px; what leaves the frame dominates such waves
    harmonic[likelihood.band] = np.where(too_long, 0, values)
    return harmonic
