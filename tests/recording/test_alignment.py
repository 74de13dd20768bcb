"""Motion of a camera that turns, whatever its field of view."""

import numpy as np
import pytest
from scipy import ndimage
from scipy.spatial.transform import Rotation

from deepir.recording import alignment
from deepir.recording.alignment import centred, project, spline, turned, weighted_mean
from deepir.recording.burst import find_burst

SIZE, HALF = (96, 128), 64.0


@pytest.mark.parametrize("curvature", [0.05, 0.17, 0.7])
def test_a_turn_is_the_homography_of_a_rotation(curvature):
    shift, focal = np.array([25.0, -11.0]), HALF / curvature**0.5
    matrix = np.diag([focal, focal, 1.0])
    axis = np.array([-shift[1], shift[0], 0]) / np.linalg.norm(shift)
    rotation = Rotation.from_rotvec(axis * 2 * np.arctan(np.linalg.norm(shift) / 2 / focal)).as_matrix()
    expected = matrix @ rotation @ np.linalg.inv(matrix)
    found = turned(shift, curvature, HALF)
    np.testing.assert_allclose(found / found[2, 2], expected / expected[2, 2], atol=1e-12)
    np.testing.assert_allclose(project(found, -shift[1] / 2, -shift[0] / 2), shift[::-1] / 2)


def test_a_turn_of_a_far_camera_is_a_shift():
    np.testing.assert_allclose(
        turned(np.array([5.0, 2.0]), 1e-9, HALF), turned(np.array([5.0, 2.0]), 0.0, HALF), atol=1e-3
    )


@pytest.mark.parametrize("curvature", [0.0, 0.2])
def test_the_curvature_of_a_pan_is_found(curvature):
    rng = np.random.default_rng(0)
    scene = ndimage.gaussian_filter(rng.normal(size=(300, 400)), 2) * 400
    y, x = centred(SIZE)
    frames = []
    for along in np.linspace(-30, 30, 16):
        v, u = project(turned(np.array([along, 0.1 * along]), curvature, HALF), y, x)
        frames.append(ndimage.map_coordinates(scene, [v + 150, u + 200], order=3))
    frames = np.array(frames, np.float32) + rng.normal(size=(16, *SIZE)).astype(np.float32)
    usable = np.ones(frames.shape, bool)
    found = find_burst(frames, usable, 8, np.zeros(SIZE), np.ones(len(frames)))
    assert found.bursts[0].curvature == pytest.approx(curvature, abs=0.02)
    assert len(found.numbers) >= 12


def test_the_equations_of_a_step_are_sums_over_what_it_moves():
    down, across, weights = np.random.default_rng(0).normal(size=(3, 2, 12, 16))
    y, x = centred((12, 16))
    moved = [project(alignment._as_matrix(1e-6 * step, 8.0), y, x) for step in np.eye(8)]
    change = np.stack([(down * (v - y) + across * (u - x)) / 1e-6 for v, u in moved])
    normal = np.einsum("inyx,jnyx,nyx->nij", change, change, weights)
    np.testing.assert_allclose(alignment._normal_of_steps(down, across, weights), normal, atol=1e-3)
    score = np.einsum("inyx,nyx->ni", change, weights)
    np.testing.assert_allclose(alignment._moments_of_steps(weights * down, weights * across), score, atol=1e-3)


def test_the_mean_on_the_canvas_is_that_of_the_frames_there():
    motion = np.stack([turned(np.array([shift, 0.3 * shift]), 0.1, 16.0) for shift in (-9.0, 0.0, 4.5)])
    canvas, frames = alignment.Canvas(motion, (24, 32)), np.random.default_rng(1).normal(size=(3, 24, 32))
    weights = canvas.spread_weights(np.ones(frames.shape, np.float32))
    expected = weighted_mean(canvas.spread(frames), weights)
    np.testing.assert_allclose(canvas.mean(spline(frames), weights), expected, atol=1e-5)
    predicted, *slopes = canvas.predicted_with_slopes(expected)
    np.testing.assert_array_equal(predicted, canvas.predicted(expected))
    inner = np.s_[:, 4:-4, 4:-4]  # beyond its edge the canvas is flat
    for step, slope in zip(np.array([[0, 2e-3], [2e-3, 0]]), slopes, strict=True):
        canvas.move(turned(step, 0.0, 16.0) @ motion)
        np.testing.assert_allclose((canvas.predicted(expected) - predicted)[inner] / 2e-3, slope[inner], atol=0.03)
