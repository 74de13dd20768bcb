"""The networks are those of their papers, and do what the papers say of them."""

import math

import pytest
import torch
from torch import nn

from deepir.assembly import build_scene
from deepir.config import load
from deepir.priors.networks.base import Network
from deepir.priors.networks.coordinates import Gabor, Grid, Sine, Siren
from deepir.priors.networks.dip import DIP
from deepir.priors.networks.skip_network import Padded, Skip, upsample_join_convolve
from deepir.registry import components

SHAPE = (1, 1, 50, 70)


def published(name):
    """The field of a preset."""
    field, _ = build_scene(load("nuc", [f"prior={name}"]).scene, SHAPE)
    return field


def count(field):
    return sum(p.numel() for p in field.parameters())


@pytest.mark.parametrize(
    ("name", "parameters"),
    [
        ("dip_2021", 2_189_829),
        ("dip_official", 2_217_573),  # 2,217,831 with three colours
        ("deep_decoder_official", 6 * 128 * 128 + 6 * 2 * 128 + 128),
        ("siren_official", (2 + 1) * 256 + 3 * (256 + 1) * 256 + 257),
        ("fourier_official", (512 + 1) * 256 + 2 * (256 + 1) * 256 + 257),
        # The first layer is real, the last gives the real part of a complex value alone.
        ("wire_official", 3 * 181 + 2 * 2 * 182 * 181 + 2 * 181 + 1),
    ],
)
def test_the_published_networks_have_their_number_of_parameters(name, parameters):
    assert count(published(name)) == parameters


def test_the_skip_network_reflects_at_edges_and_its_input_is_weak_noise_on_a_canvas_that_it_can_halve():
    field = published("dip_official")
    assert field.noise.shape == (1, 32, 64, 96)
    assert 0 <= field.noise.min() < field.noise.max() <= 0.1
    assert field.noise.mean() == pytest.approx(0.05, abs=1e-3)
    assert field().shape == SHAPE
    wide = [each for each in field.net.modules() if isinstance(each, nn.Conv2d) and each.kernel_size[0] == 3]
    assert [each.padding_mode for each in wide] == ["reflect"] * 3 * 5


@pytest.mark.parametrize("stride", [1, 2])
def test_a_padded_convolution_is_torchs_own(stride):
    ours = Padded(3, 4, 3, stride, "reflect").double()
    theirs = nn.Conv2d(3, 4, 3, stride, 1, padding_mode="reflect").double()
    theirs.load_state_dict(ours.state_dict())
    x = torch.rand(2, 3, 8, 6, dtype=torch.float64)
    torch.testing.assert_close(ours(x), theirs(x))


def test_in_bfloat16_nothing_of_the_skip_network_is_padded_or_doubled_in_float32(monkeypatch):
    seen = []
    for name in ("pad", "interpolate"):
        whole = getattr(torch.nn.functional, name)
        monkeypatch.setattr(
            torch.nn.functional, name, lambda x, *a, whole=whole, **k: seen.append(x.dtype) or whole(x, *a, **k)
        )
    net = Skip(4, [8, 8])
    with torch.autocast("cpu", torch.bfloat16):
        net(torch.rand(1, 4, 16, 16)).sum().backward()
    assert seen.count(torch.float32) == 1  # the input of the first
    assert len(seen) == 8


@pytest.fixture
def join():
    """Convolution and normalisation of a scale with three channels of its own and six of the one below."""
    skip = Skip(2, [6, 6], skip=3)
    return skip.rise[0][0][0], skip.join[0]


@pytest.mark.parametrize("height", [1, 2, 5])
def test_rows_that_are_doubled_after_the_convolution_give_what_they_give_before_it(height, join):
    convolution, norm = (each.double() for each in join)
    nn.init.normal_(norm.weight)
    nn.init.normal_(norm.bias)
    beside = torch.randn(2, 3, 2 * height, 8, dtype=torch.float64, requires_grad=True)
    deep = torch.randn(2, 6, height, 4, dtype=torch.float64, requires_grad=True)
    doubled = nn.functional.interpolate(deep, scale_factor=2, mode="bilinear")
    plain = convolution(norm(torch.cat((beside, doubled), 1)))
    quick = upsample_join_convolve(beside, deep, norm, convolution)
    torch.testing.assert_close(quick, plain)
    into = (beside, deep, *norm.parameters(), *convolution.parameters())
    weights = torch.randn_like(plain)
    gradients = [torch.autograd.grad((each * weights).sum(), into) for each in (quick, plain)]
    torch.testing.assert_close(*gradients)


def test_a_channel_that_is_constant_has_no_variance_in_bfloat16(join):
    deep = torch.rand(6, 1, 1).bfloat16().expand(1, 6, 4, 4)
    with torch.autocast("cpu", torch.bfloat16):
        assert upsample_join_convolve(torch.rand(1, 3, 8, 8).bfloat16(), 3 * deep, *join[::-1]).isfinite().all()


def test_perturbed_input_is_drawn_anew_for_each_gradient_and_never_for_a_result():
    field = DIP((1, 1, 11, 9), width=4, scales=2, inputs=2, perturb=0.1)
    assert not torch.equal(field(), field())
    with torch.no_grad():
        assert torch.equal(field(), field())


def test_the_layers_of_a_siren_keep_the_distribution_of_their_values():
    # Sitzmann et al., theorem 1.8: before each sine about a standard normal, after it an arcsine of variance 1/2.
    field = published("siren_official")
    x = field.points
    for i, layer in enumerate(each for each in field.net if isinstance(each, Sine)):
        before = layer.omega * x @ layer.linear.weight.T  # biases are left as they are, as in the published code
        x = layer(x)
        if i > 0:
            assert float(before.std().detach()) == pytest.approx(1.0, abs=0.15)
            assert float(x.var().detach()) == pytest.approx(0.5, abs=0.1)


def test_the_waves_of_fourier_features_have_the_published_bandwidth():
    frequencies = published("fourier_official").net[0].frequencies
    assert frequencies.shape == (2, 256)
    assert float(frequencies.std()) == pytest.approx(10, rel=0.1)


def test_a_gabor_layer_is_complex_arithmetic_in_real_numbers():
    layer, x = Gabor(3, 5, 4.0, 2.0), torch.randn(7, 6)
    weight, bias = (torch.complex(*each.chunk(2)) for each in (layer.linear.weight, layer.linear.bias))
    z = torch.complex(*x.chunk(2, -1)) @ weight.T + bias
    value = torch.exp(4j * z - (2 * z).abs().square())
    assert torch.allclose(layer(x), torch.cat((value.real, value.imag), -1), atol=1e-5)


def test_coordinates_go_from_minus_one_to_one_along_the_longer_side():
    points = Siren((1, 1, 3, 5), width=4, depth=1).points.reshape(3, 5, 2)
    assert points[:, 0, 0].tolist() == [-1] * 3
    assert points[:, -1, 0].tolist() == [1] * 3
    assert points[0, :, 1].tolist() == [-0.5] * 5
    assert points[1, 2].tolist() == [0, 0]


@pytest.mark.parametrize("name", ["dip", "dip_residual", "deep_decoder", "siren", "fourier", "wire"])
def test_a_residual_begins_at_what_it_starts_from(name):
    field, value = published(name), 8000 + 100 * torch.rand(SHAPE)
    field.init_from(value)
    assert torch.allclose(field(), value, rtol=1e-5)


def fitted(field, target, iterations):
    """Root mean square errors as a field is fitted to a picture."""
    optimiser = torch.optim.Adam(field.parameters(), lr=0.01)
    for _ in range(iterations):
        optimiser.zero_grad()
        (field() - target).square().mean().backward()
        optimiser.step()
    return math.sqrt(float((field() - target).square().mean().detach()))


def test_a_skip_network_takes_to_a_picture_sooner_than_to_noise():
    # Ulyanov et al., figure 2: its structure resists noise.
    y, x = torch.meshgrid(*(torch.linspace(-1, 1, side) for side in (32, 40)), indexing="ij")
    picture = ((x**2 + y**2 < 0.4).float() + x)[None, None]
    picture = (picture - picture.mean()) / picture.std()
    errors = []
    for target in (picture, torch.randn(1, 1, 32, 40)):
        torch.manual_seed(0)
        errors.append(fitted(DIP((1, 1, 32, 40), width=16, scales=3), target, 30))
    assert errors[0] < 0.5 * errors[1]


def test_grids_represent_any_picture():
    target = torch.randn(1, 1, 16, 20)
    assert fitted(Grid(target.shape), target, 300) < 0.1


def test_bfloat16_changes_a_picture_by_little_and_leaves_parameters_float32():
    torch.manual_seed(0)
    field = DIP((1, 1, 32, 40), width=16, scales=3)
    exact = field().detach()
    field.bf16 = True
    assert float((field().detach() - exact).std() / exact.std()) < 0.1
    assert field().dtype == torch.float32
    assert all(p.dtype == torch.float32 for p in field.parameters())


@pytest.mark.parametrize(("kind", "options"), [(DIP, {"width": 0}), (Grid, {"levels": 0}), (Siren, {"omega": -1.0})])
def test_options_are_checked(kind, options):
    with pytest.raises(ValueError, match="must be"):
        kind((1, 1, 8, 9), **options)


@pytest.mark.parametrize("name", [name for name, each in components("field").items() if issubclass(each, Network)])
def test_scenes_of_their_own_are_drawn_each(name):
    kind, shape = components("field")[name], (3, 1, 12, 14)
    field = kind(shape, **kind.example_options)
    assert field().shape == shape
    field.init_from(torch.rand(shape))
    fitted(field, torch.arange(3.0).view(3, 1, 1, 1), 40)
    means = field().detach().mean((1, 2, 3))
    assert means[0] < means[1] < means[2]
