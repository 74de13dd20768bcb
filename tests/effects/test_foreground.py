"""Which frames show somebody is decided by what stands nearby and by how bright he and the scene are."""

import torch

from deepir.effects.moving_objects import foreground

SHAPE = (60, 80)


def walk(scene, his, at, size=(24, 14)):
    """Frames (N, H, W) in which a rectangle of `his` flux stands `at` some (row, column), and where it does."""
    flux, where = scene.expand(len(at), *SHAPE).clone(), torch.zeros(len(at), *SHAPE, dtype=torch.bool)
    for k, (row, column) in enumerate(at):
        where[k, row : row + size[0], column : column + size[1]] = True
    return torch.where(where, his, flux), where


def found(flux, where):
    """What is found of `where` in its places, and which of these some frame shows without him."""
    torch.manual_seed(0)
    flux = flux + 0.01 * torch.randn(flux.shape)
    places = where.any(0) & ~where.all(0)
    middle = (flux.amin(0) + flux.amax(0)) / 2
    known = torch.ones_like(where)
    shown = foreground(flux, known, places & (flux > middle), places & (flux <= middle))
    assert not shown[:, ~places].any()
    return shown == where & places, places


def test_places_that_he_covers_in_most_frames_are_his_too():
    """He is 14 px wide: some columns are his in four frames of five."""
    at = [(20, 20 + step) for step in (0, 4, 8, 12, 16)]
    flux, where = walk(torch.full(SHAPE, 0.3), torch.tensor(0.8), at)
    assert (where.sum(0) == 4).any()
    right, places = found(flux, where)
    assert right[:, places].float().mean() > 0.99


def test_a_foot_that_stands_in_four_frames_of_five_is_detected_by_how_bright_it_is():
    """Four frames are the more; where he is in few, beside it, tells how bright he is."""
    his = torch.tensor(0.8)
    flux, where = walk(torch.full(SHAPE, 0.3), his, [(20, 20)] * 4 + [(20, 60)], (10, 8))
    flux, stood = walk(flux, his, [(30, 4 + 13 * k) for k in range(5)], (26, 12))
    right, places = found(flux, where | stood)
    foot = torch.zeros_like(places)
    foot[20:30, 20:28] = True
    assert right[:, foot & places].float().mean() > 0.95


def test_whether_he_is_warm_or_cold_does_not_matter():
    at = [(20, 10 + step) for step in (0, 6, 12, 18, 24)]
    flux, where = walk(torch.linspace(0.2, 0.5, SHAPE[1]).expand(SHAPE), torch.tensor(0.9), at)
    (warm, _), (cold, _) = found(flux, where), found(1 - flux, where)
    assert (warm == cold).float().mean() > 0.999


def test_without_places_nobody_is_shown():
    flux = torch.rand(3, *SHAPE)
    nowhere = torch.zeros(3, *SHAPE, dtype=torch.bool)
    assert not foreground(flux, ~nowhere, nowhere, nowhere).any()


def test_what_no_frame_knows_takes_no_part():
    at = [(20, 20 + step) for step in (0, 5, 10, 15, 20)]
    flux, where = walk(torch.full(SHAPE, 0.3), torch.tensor(0.8), at)
    known = torch.ones_like(where)
    known[:, :15] = known[4] = False
    places = (where & known).any(0) & ~(where | ~known).all(0)
    groups = [places & known & group for group in (flux > 0.5, flux <= 0.5)]
    clean = foreground(flux, known, *groups)
    assert torch.equal(clean, foreground(flux.where(known, torch.rand(flux.shape) * 1e3), known, *groups))
    assert not (clean & ~known).any()
