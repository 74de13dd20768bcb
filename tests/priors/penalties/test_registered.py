"""What every registered penalty keeps to, and the shipped ones against numpy."""

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from deepir.registry import components

PENALTIES = components("penalty")
each_penalty = pytest.mark.parametrize("name", PENALTIES)


def picture(seed=0, shape=(1, 1, 7, 9)):
    return torch.randn(shape, dtype=torch.float64, generator=torch.Generator().manual_seed(seed))


def gradient(x):
    """|∇x| at each pixel, by numpy."""
    return np.hypot(np.diff(x, axis=0, append=x[-1:]), np.diff(x, axis=1, append=x[:, -1:]))


def bends(x):
    """|∇²x| at each pixel, by numpy."""
    xx, yy, xy = np.zeros((3, *x.shape))
    xx[:, 1:-1], yy[1:-1] = np.diff(x, 2, axis=1), np.diff(x, 2, axis=0)
    xy[:-1, :-1] = np.diff(np.diff(x, axis=0), axis=1)
    return np.sqrt(xx**2 + yy**2 + 2 * xy**2)


def rounded(values, e):
    return np.hypot(values, e) - e


def huber(values, d):
    return np.where(values < d, values**2 / (2 * d), values - d / 2)


REFERENCES = {
    "tv": lambda x, weight: rounded(gradient(x), 0.1 / weight).sum(),
    "huber_tv": lambda x, weight: huber(gradient(x), 1 / weight).sum(),
    "hessian": lambda x, weight: rounded(bends(x), 0.1 / weight).sum(),
    "smooth": lambda x, weight: (gradient(x) ** 2).sum() / 2,
    "ridge": lambda x, weight: (x**2).sum() / 2,
    "l1": lambda x, weight: np.abs(x).sum(),
}
OF_GRADIENTS = ["tv", "huber_tv", "smooth", "hessian"]


@pytest.mark.parametrize("name", REFERENCES)
@pytest.mark.parametrize("weight", [0.3, 2.0])
def test_the_energy_is_the_references(name, weight):
    x = picture()
    found = PENALTIES[name].example(weight=weight).energy(x)
    assert float(found) == pytest.approx(REFERENCES[name](x[0, 0].numpy(), weight), rel=1e-6)


@each_penalty
def test_the_weight_scales_the_energy_and_is_one_until_it_is_known(name):
    x = picture()
    penalty = PENALTIES[name].example()
    assert penalty.user_weight is None
    assert torch.allclose(penalty(x), penalty.energy(x))
    penalty = PENALTIES[name].example(weight=3.0)
    assert penalty.user_weight == 3.0
    assert torch.allclose(penalty(x), 3 * penalty.energy(x))
    assert float(PENALTIES[name].example(weight=0.0)(x).detach()) == 0


@each_penalty
@pytest.mark.parametrize("weight", [-1.0, float("nan"), float("inf")])
def test_a_weight_must_be_a_number_of_at_least_zero(name, weight):
    with pytest.raises(ValueError, match="weight"):
        PENALTIES[name].example(weight=weight)


@each_penalty
def test_the_gradient_is_right(name):
    # weight 3: both sides of huber_tv's threshold
    assert torch.autograd.gradcheck(PENALTIES[name].example(weight=3.0), picture().requires_grad_())


@each_penalty
def test_it_is_a_scalar_and_finite_in_float32_with_gradients_even_where_the_scene_is_flat(name):
    x = torch.full((1, 1, 7, 9), 8000.0, requires_grad=True)
    value = PENALTIES[name].example()(x)
    assert value.shape == ()
    (slope,) = torch.autograd.grad(value, x)
    assert slope.dtype == torch.float32
    assert slope.isfinite().all()


@each_penalty
def test_the_natural_weight_belongs_to_the_units(name):
    """In other units, value and noise alike, a penalty of gradients is the same number of nats."""
    weight = PENALTIES[name].example().default_weight
    assert weight(0.1) > 0
    if name in (*OF_GRADIENTS, "foe"):
        one, other = (float(PENALTIES[name].example(weight=weight(0.1 * s))(s * picture())) for s in (1.0, 1e3))
        assert one == pytest.approx(other, rel=1e-5)


@pytest.mark.parametrize("name", OF_GRADIENTS)
@settings(max_examples=20, deadline=None)
@given(level=st.floats(-1e4, 1e4))
def test_penalties_of_gradients_do_not_see_the_level_but_a_column_or_a_row(name, level):
    penalty = PENALTIES[name].example(weight=0.7)
    assert float(penalty(torch.full((1, 1, 5, 6), level, dtype=torch.float64))) == 0
    assert float(penalty(picture() + level)) == pytest.approx(float(penalty(picture())), rel=1e-6)
    assert min(float(penalty(picture(shape=shape))) for shape in ((1, 1, 1, 9), (1, 1, 9, 1))) > 0


@pytest.mark.parametrize("name", ["ridge", "l1"])
def test_penalties_of_values_are_zero_at_their_center(name):
    penalty = PENALTIES[name].example(center=1.0)
    assert float(penalty(torch.ones(1, 1, 5, 6))) == 0 < float(penalty(torch.zeros(1, 1, 5, 6)))


@pytest.mark.parametrize("name", REFERENCES)
@settings(max_examples=30, deadline=None)
@given(seeds=st.tuples(st.integers(0, 99), st.integers(100, 199)), t=st.floats(0, 1), scale=st.floats(0.01, 100))
def test_the_shipped_penalties_are_convex_and_not_negative(name, seeds, t, scale):
    penalty = PENALTIES[name].example(weight=1.5)
    a, b = (scale * picture(seed) for seed in seeds)
    between, chord = penalty(t * a + (1 - t) * b), t * penalty(a) + (1 - t) * penalty(b)
    assert between >= 0
    assert between <= chord * (1 + 1e-9) + 1e-9


def test_the_rounding_of_tv_is_in_units_of_one_nat():
    # An edge of a tenth of 1 / weight is where TV bends, whatever the units.
    edge = torch.zeros(1, 1, 1, 2, dtype=torch.float64)
    edge[..., 1] = 0.1
    costs = [float(PENALTIES["tv"](weight=1 / s)(s * edge)) for s in (1e-3, 1.0, 1e4)]
    assert costs == pytest.approx([0.1 * (2**0.5 - 1)] * 3, rel=1e-6)


@pytest.mark.parametrize(("name", "option"), [("tv", "rounding"), ("huber_tv", "threshold")])
def test_options_are_checked(name, option):
    with pytest.raises(ValueError, match=option):
        PENALTIES[name].example(**{option: 0.0})
