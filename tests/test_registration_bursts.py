"""Registration of simulated bursts against the truth: strong patterns, wide motion, frames that do not belong."""

import functools

import numpy as np
import pytest
import scipy.ndimage
import skimage.data
import torch
from hypothesis import given
from hypothesis import settings as settings_of_hypothesis
from hypothesis import strategies as st

from deepir import threads
from deepir.registration import burst, likelihood, register, vote, whole
from deepir.registration.even import even
from deepir.registration.motion import rotation
from deepir.registration.pyramid import Level, sample
from deepir.scenes import procedural, sky
from deepir.simulate import Settings, simulate
from deepir.simulate.pictures import picture as scene

SHAPE = (128, 160)
#: Counts on a pedestal: a pixel's gain of 3 % is a pattern of 240 counts.
COUNTS = {"counts": True, "max_rotation": 2.0}
FAINT = {**COUNTS, "contrast": 60.0, "read_noise": 0.07}


@functools.cache
def simulated(name, **settings):
    """Frames `(N, H, W)` of a public picture and their true motions; the same camera for all pictures."""
    picture = getattr(skimage.data, name)().astype(float)
    picture = picture if picture.ndim == 2 else picture.mean(-1)
    picture = (picture - picture.min()) / np.ptp(picture)
    found = simulate(picture, Settings(shape=SHAPE, **settings), seed=1)
    return torch.from_numpy(found.frames.astype(np.float32)), found.truth.motion


def errors(result, truth):
    """Largest distance (px) at the corners, of each frame that is used; the truth relative to the first of them."""
    used = result.used.numpy()
    first = used.argmax()
    true = np.linalg.inv(truth[first]) @ truth[used]
    h, w = SHAPE
    corners = np.array([(x, y, 1.0) for x in (-w / 2, w / 2) for y in (-h / 2, h / 2)]).T
    a, b = result.motion.numpy()[used] @ corners, true @ corners
    assert np.array_equal(result.motion[first], np.eye(3))
    return np.linalg.norm(a[:, :2] / a[:, 2:] - b[:, :2] / b[:, 2:], axis=1).max(1)


@pytest.mark.parametrize("name", ["camera", "moon", "gravel", "astronaut", "grass"])
def test_a_pattern_four_times_the_scenes_contrast_is_seen_through(name):
    frames, truth = simulated(name, **FAINT)
    result = register(frames)
    assert result.used.all()
    assert errors(result, truth).max() < 0.7


@pytest.mark.parametrize(
    "camera",
    [
        {"gain_column": 0.5, "gain_distribution": "uniform", "gain_pixel": 0.0},
        {"gain_pixel": 0.1},
        {"photons": 150.0},
    ],
)
def test_half_the_gain_in_columns_a_tenth_in_pixels_or_few_photons_do_no_harm(camera):
    for name in ("camera", "grass"):
        frames, truth = simulated(name, **camera)
        result = register(frames)
        assert result.used.all()
        assert errors(result, truth).max() < 0.35


@pytest.mark.parametrize(("number", "n_frames", "camera"), [(1, 3, {}), (2, 5, {}), (3, 3, {"counts": True})])
def test_clouds_under_a_pattern_stronger_than_they_are_find_their_places(number, n_frames, camera):
    settings = Settings(n_frames=n_frames, shading=0.0, dead_pixels=0.0, **camera)
    found = simulate(sky(number, (430, 500)), settings, seed=12)
    result = register(torch.from_numpy(found.frames.astype(np.float32)))
    assert result.used.all()
    assert np.abs((result.motion.numpy() - found.truth.motion)[:, :2, 2]).max() < 0.5


@pytest.mark.parametrize(("power", "seed"), [(1, 31), (4, 79), (6, 79)])
def test_three_frames_of_which_two_lie_close_do_not_end_where_residuals_are_small(power, seed):
    picture = (
        scene("moon") if power == 1 else procedural(2 * power - 3, (430, 500)) ** power
    )  # dark, few details
    rows = {"photons": 1000.0, "read_noise": 0.002, "gain_row": 0.05, "offset_row": 0.05}
    camera = rows if power == 1 else {"counts": True, "read_noise": 0.003, "offset_pixel": 0.04}
    sim = simulate(picture, Settings(shading=0.0, dead_pixels=0.0, n_frames=3, **camera), seed=seed)
    shifts = register(torch.from_numpy(sim.frames.astype(np.float32))).motion.numpy()[:, :2, 2]
    assert np.abs(shifts - sim.truth.motion[:, :2, 2]).max() < 0.4


def camera_of_tones(**settings):
    """160 x 192 px, scenes in [0, 1]; a thousand photons, no bad pixels."""
    fixed = {"shading": 0.0, "dead_pixels": 0.0, "photons": 1000.0, "read_noise": 0.002}
    return Settings(**(fixed | settings))


def apart(sim, shifts):
    """Largest distance (px) along an axis between found and true shifts."""
    return np.abs(shifts - sim.truth.motion[:, :2, 2]).max()


def test_somebody_who_walks_does_not_take_the_likelihood_along():
    walker = {"walker": 0.5, "walker_contrast": 0.3}
    sim = simulate(procedural(3, (430, 500)), camera_of_tones(n_frames=5, shape=(96, 128), **walker), seed=57)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    shifts = register(frames).motion[:, :2, 2].numpy()
    followed = likelihood.likeliest_shifts(even(frames, torch.ones(96, 128)), shifts[1:])
    assert apart(sim, np.vstack((shifts[:1], followed))) < 0.3
    assert apart(sim, shifts) < 0.2


@pytest.mark.parametrize("number", [1, 2, 4])
def test_a_bright_slope_with_three_frames_finds_its_places(number):
    sim = simulate(sky(number, (430, 500)), camera_of_tones(n_frames=3), seed=31)
    assert (
        apart(sim, register(torch.from_numpy(sim.frames.astype(np.float32))).motion.numpy()[:, :2, 2]) < 0.35
    )


@pytest.mark.parametrize("seed", [30, 35])
def test_clouds_that_move_are_not_taken_for_still_ones(seed):
    counts = {"counts": True, "read_noise": 0.003, "photons": 0.0}
    sim = simulate(sky(1, (430, 500)), camera_of_tones(n_frames=3, **counts), seed=seed)
    assert (
        apart(sim, register(torch.from_numpy(sim.frames.astype(np.float32))).motion.numpy()[:, :2, 2]) < 0.3
    )


@pytest.mark.parametrize(
    ("number", "seed", "camera"),
    [(6, 32, {"counts": True, "read_noise": 0.003, "photons": 0.0}), (2, 57, {})],
)
def test_clouds_whose_residuals_are_least_at_a_far_place_find_theirs(number, seed, camera, monkeypatch):
    sim = simulate(sky(number, (430, 500)), camera_of_tones(n_frames=3, **camera), seed=seed)
    frames = torch.from_numpy(sim.frames.astype(np.float32))
    assert apart(sim, register(frames).motion.numpy()[:, :2, 2]) < 0.5
    monkeypatch.setattr(vote, "FEW", 2)
    assert not apart(sim, register(frames).motion.numpy()[:, :2, 2]) < 0.5


@pytest.mark.parametrize("name", ["camera", "moon", "gravel", "astronaut"])
def test_whole_shifts_are_right_to_a_px_or_so_whatever_the_pattern(name):
    frames, truth = simulated(name, n_frames=4)
    found = whole.whole_shifts(even(frames, torch.ones(SHAPE)))
    assert np.abs(found - truth[1:, :2, 2]).max() < 1.5


def test_a_frame_beside_another_is_weighed_by_the_first_harmonic_of_their_likelihood():
    rng = np.random.default_rng(3)
    spectra = likelihood.Spectra(torch.from_numpy(rng.normal(size=(2, 24, 30)).cumsum(1)))
    found = whole.first_harmonic(spectra, 1, np.array([True, False]), np.zeros((2, 2), int))[spectra.known]
    turns = np.exp(2j * np.pi * np.arange(64) / 64)
    for wave in ((5, 4), (2, 7), (12, 3)):
        scene, noise = spectra.scene[wave], spectra.noise[wave]
        seen, nats = spectra.frames[:, *wave], []
        for turn in turns:
            of_scene = scene * np.outer([1, turn], [1, turn.conj()])
            covariance = of_scene + spectra.pattern + noise * np.eye(2)
            misfit = (seen.conj() @ np.linalg.solve(covariance, seen)).real
            nats.append(np.linalg.slogdet(covariance)[1] + misfit)
        assert np.isclose(found[wave], np.mean(nats * turns.conj()), rtol=1e-6)


@given(
    gain=st.floats(0.02, 0.1),
    offset=st.floats(0.0, 0.1),
    seed=st.integers(0, 99),
    unit=st.sampled_from([1.0, 1500.0]),
)
@settings_of_hypothesis(max_examples=20, deadline=None)
def test_a_pattern_is_as_strong_in_the_bright_as_in_the_dark_once_it_is_even(gain, offset, seed, unit):
    rng = np.random.default_rng(seed)
    flux = np.tile(np.linspace(0.1, 1.5, 160), (128, 1))
    frame = flux * (1 + gain * rng.normal(size=flux.shape)) + offset * rng.normal(size=flux.shape)
    bent = even(torch.from_numpy(unit * frame)[None], torch.ones(128, 160))[0].numpy()
    fine = bent - scipy.ndimage.gaussian_filter(bent, 3)
    dark, bright = fine[:, :60].std(), fine[:, 100:].std()
    assert 0.6 < bright / dark < 1.6


def test_the_slope_of_the_shifts_likelihood_is_that_of_its_differences():
    frames, truth = simulated("moon")
    shifts = truth[1:, :2, 2].ravel() + 0.3
    spectra = likelihood.Spectra(even(frames, torch.ones(SHAPE)))
    around = [spectra.nats(shifts + 1e-5 * way * unit)[0] for unit in np.eye(len(shifts)) for way in (1, -1)]
    np.testing.assert_allclose(
        spectra.nats(shifts)[1], (np.array(around[::2]) - around[1::2]) / 2e-5, rtol=1e-4
    )


@pytest.mark.parametrize("name", ["camera", "astronaut", "grass"])
def test_a_quarter_of_the_frame_and_eight_degrees_are_found(name):
    frames, truth = simulated(name, max_shift=32.0, max_rotation=8.0)
    result = register(frames)
    assert result.used.all()
    assert errors(result, truth).max() < 0.2


@pytest.mark.parametrize("model", ["affine", "homography"])
def test_a_per_cent_of_stretch_and_of_keystone_are_found(model):
    frames, truth = simulated("astronaut", motion=model, max_rotation=2.0)
    assert errors(register(frames, model=model), truth).max() < 0.4


def strangers(frames, **settings):
    """What a frame may be that does not belong: another scene, a shutter, noise, nothing."""
    generator = torch.Generator().manual_seed(0)
    noise = torch.randn(SHAPE, generator=generator)
    mean = frames.mean(0)
    shutter = frames.median() + mean - torch.nn.functional.avg_pool2d(mean[None], 5, 1, 2)[0]
    return {
        "scene": simulated("gravel", **settings)[0][2],
        "shutter": shutter + 0.01 * frames.std() * noise,
        "noise": frames.mean() + 0.5 * frames.std() * noise,
        "nothing": torch.full(SHAPE, float(frames.mean())),
    }


@pytest.mark.parametrize("settings", [{}, COUNTS], ids=["unit", "counts"])
@pytest.mark.parametrize("place", [0, 3])
def test_a_frame_that_does_not_belong_is_left_out_wherever_it_is(settings, place):
    frames, truth = simulated("camera", **settings)
    alone = errors(register(frames[[k for k in range(5) if k != place]]), np.delete(truth, place, 0)).max()
    for kind, stranger in strangers(frames, **settings).items():
        spoilt = frames.clone()
        spoilt[place] = stranger
        result = register(spoilt)
        assert result.used.tolist() == [k != place for k in range(5)], kind
        assert result.motion[place].isnan().all()
        assert result.messages[0].startswith(f"frame {place} does not register")
        assert errors(result, truth).max() < alone + 0.1


def test_without_frame_0_motions_are_relative_to_the_first_that_is_used():
    frames, _ = simulated("camera")
    spoilt = frames.clone()
    spoilt[0] = simulated("gravel")[0][0]
    result = register(spoilt)
    assert torch.equal(result.motion[1], torch.eye(3, dtype=torch.float64))
    assert "relative to it" in result.messages[-1]


def test_three_frames_of_one_scene_outvote_two_of_others():
    frames, truth = simulated("astronaut")
    spoilt = frames.clone()
    spoilt[0], spoilt[3] = simulated("gravel")[0][0], simulated("moon")[0][3]
    result = register(spoilt)
    assert result.used.tolist() == [False, True, True, False, True]
    assert errors(result, truth).max() < 0.3


@pytest.mark.parametrize("settings", [{}, FAINT], ids=["unit", "faint"])
def test_a_burst_that_stands_still_is_found_still(settings):
    frames, _ = simulated("camera", **settings, n_frames=1)
    noise = 0.01 * frames.std() * torch.randn(5, *SHAPE)
    result = register(frames + noise)
    assert result.used.all()
    assert torch.equal(result.motion, torch.eye(3, dtype=torch.float64).expand(5, 3, 3))


@pytest.mark.parametrize("name", ["camera", "moon", "astronaut"])
@pytest.mark.parametrize("seed", [5, 6])
def test_pixels_that_flicker_do_not_set_a_still_burst_in_motion(name, seed):
    settings = Settings(n_frames=5, shape=(120, 160), counts=True, max_shift=0.0)
    found = simulate(scene(name), settings, seed=seed)
    result = register(torch.from_numpy(found.frames.astype(np.float32)))
    assert np.abs((result.motion.numpy() - np.eye(3))[result.used.numpy()]).max() < 0.1


def test_an_object_that_goes_its_own_way_does_not_take_the_motion_along():
    frames, truth = simulated("astronaut")
    alone = errors(register(frames), truth).max()
    crossed = frames.clone()
    patch = 1.5 * simulated("gravel")[0][0, :40, :36] + 0.3  # 7 % of the frame
    for k, frame in enumerate(crossed):
        frame[30 + 3 * k : 70 + 3 * k, 20 + 12 * k : 56 + 12 * k] = patch
    result = register(crossed)
    assert result.used.all()
    assert errors(result, truth).max() < alone + 0.1


def test_a_large_frame_is_registered_from_half_its_size(monkeypatch):
    frames, truth = simulated("camera", **COUNTS)
    monkeypatch.setattr(burst, "COARSE", 40)
    assert errors(register(frames), truth).max() < 0.3
    monkeypatch.setattr(burst, "FINEST", SHAPE[0] * SHAPE[1] // 3)
    assert errors(register(frames), truth).max() < 0.5


@pytest.mark.parametrize("camera", [{"n_frames": 3, "max_rotation": 5.0}, {**COUNTS, "dead_pixels": 0.02}])
def test_the_number_of_threads_makes_no_difference(camera):
    frames, _ = simulated("camera", **camera)
    found = []
    for number in (1, 3):
        with threads.for_loops(number):
            found.append(register(frames))
    assert torch.equal(found[0].motion, found[1].motion)
    assert torch.equal(found[0].confidence, found[1].confidence)


@pytest.mark.parametrize("bad", [0, 300])
@pytest.mark.parametrize("shape", [(2, 2), (9, 4), (30, 41)])
def test_samples_are_those_of_torch(shape, bad):
    """Also beyond the edge, under rotation and perspective; those on the very edge are left to rounding."""
    generator = torch.Generator().manual_seed(3)
    image, weight = torch.rand(shape, generator=generator), torch.ones(shape)
    weight.view(-1)[torch.randint(weight.numel(), (bad,), generator=generator)] = 0
    level = Level(1, image[None], weight, bad == 0, shape)
    motion = rotation(torch.tensor([0.0, 0.1, -0.4], dtype=torch.float64))
    motion[:, :2, 2] = torch.tensor([[0.3, -0.4], [3.2, 1.3], [-40.0, 0.2]])
    motion[1, 2, :2] = torch.tensor([1e-3, -2e-3])
    values, known = sample(image[None], motion, level)
    points = motion @ level.place @ indices(shape).flatten(1)
    points = (points[:, :2] / points[:, 2:]).reshape(3, 2, *shape).float()
    unit = points / torch.tensor(shape[::-1])[:, None, None] * 2
    ask = functools.partial(torch.nn.functional.grid_sample, grid=unit.movedim(1, -1), align_corners=False)
    wanted = ask(image.expand(3, 1, *shape), mode="bilinear")[:, 0]
    there = ask(weight.expand(3, 1, *shape), mode="nearest")[:, 0]
    edge = (torch.tensor(shape[::-1])[:, None, None] - 1) / 2
    there = there * (points.abs() <= edge).all(1)
    assert torch.equal(known, there)
    assert torch.allclose(values, wanted * there, atol=1e-5)


def indices(shape):
    y, x = torch.meshgrid(*(torch.arange(side, dtype=torch.float64) for side in shape), indexing="ij")
    return torch.stack((x, y, torch.ones_like(x)))


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_frames_of_two_thousand_pixels_are_enough(seed):
    camera = Settings(n_frames=3, shape=(40, 48), counts=True, max_shift=4.0)
    found = simulate(None, camera, seed=seed)
    result = register(torch.from_numpy(found.frames.astype(np.float32)))
    assert result.used.all()
    shift = result.motion.numpy()[:, :2, 2] - found.truth.motion[:, :2, 2]
    assert np.abs(shift).max() < 1.0  # a start; the solve goes on from there


@pytest.mark.parametrize("name", ["camera", "gravel"])
def test_frames_that_bend_are_registered_as_homographies(name):
    frames, truth = simulated(name, n_frames=5, motion="homography", photons=1000.0)
    assert errors(register(frames), truth).max() > 1
    assert errors(register(frames, model="auto"), truth).max() < 0.3


@pytest.mark.parametrize("frames", [2, 3, 5])
def test_frames_that_do_not_bend_are_rigid_to_the_bit(frames):
    frames, _ = simulated("camera", n_frames=frames, max_rotation=3.0, photons=1000.0)
    assert torch.equal(register(frames, model="auto").motion, register(frames).motion)


def test_frames_that_turn_are_not_taken_for_shifted_ones():
    found = simulate(sky(2), Settings(shape=(160, 192), n_frames=5, counts=True, max_rotation=6.0), seed=32)
    motion = register(torch.from_numpy(found.frames.astype(np.float32))).motion
    assert np.abs(motion.numpy() - found.truth.motion)[:, :2, :2].max() < 5e-3
