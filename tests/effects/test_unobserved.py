"""What no frame sees of the scene goes on smoothly from what is seen beside it."""

import torch
from hypothesis import given
from hypothesis import strategies as st
from small_problems import whole

import deepir
from deepir.arrays.windows import fill_pull_push
from deepir.assembly import build
from deepir.config import load
from deepir.effects.outliers import fill_unobserved
from deepir.simulate import Settings, simulate


@given(height=st.integers(1, 40), width=st.integers(1, 40), seed=st.integers(0, 99))
def test_what_is_known_stays_and_what_is_not_lies_between(height, width, seed):
    generator = torch.Generator().manual_seed(seed)
    image = torch.rand(1, 1, height, width, generator=generator)
    known = torch.rand(image.shape, generator=generator) < 0.3
    known[..., 0, 0] = True
    filled = fill_pull_push(image.where(known, torch.inf), known)
    assert torch.equal(filled[known], image[known])
    assert image[known].min() - 1e-6 <= filled.min()
    assert filled.max() <= image[known].max() + 1e-6


def test_stripes_that_end_at_the_edge_do_not_go_on():
    image = torch.tensor([0.0, 1.0]).repeat(32).expand(1, 1, 64, 64)
    known = torch.zeros(image.shape, dtype=torch.bool)
    known[..., 16:-16, :] = True
    filled = fill_pull_push(image, known)
    assert filled[..., :12, :].diff(dim=-1).abs().max() < 0.1


def test_frames_show_the_same_before_and_after():
    sim = simulate(None, Settings(n_frames=4, shape=(60, 70), max_shift=8.0), seed=1)
    motion = torch.from_numpy(sim.truth.motion)
    problem, _ = build(load("nuc"), whole(sim.frames), motion)
    scene = problem.fields["scene"]
    with torch.no_grad():
        scene.init_from(torch.rand(scene.shape, generator=torch.Generator().manual_seed(0)))
        before, rough = problem.predict(problem.values()), scene()
        fill_unobserved(problem)
        after, smooth = problem.predict(problem.values()), scene()
    assert (after - before).std() < 0.02 * before.std()
    changed = (smooth - rough).abs() > 1e-3
    assert 0.1 < changed.float().mean() < 0.5


def test_counts_do_not_keep_a_solve_busy_at_the_edge():
    camera = Settings(n_frames=5, shape=(96, 112), counts=True, shading=0.0, dead_pixels=0.0)
    result = deepir.run("nuc", prior="tv", frames=simulate(None, camera, seed=1).frames, threads=1)
    assert result.metrics["iterations"] < 90
