"""Checks of operators, for plugins as well.

operator, x, slots = MyOperator.example()
check_operator(operator, x, slots, reference=lambda x, slots: ...)
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Mapping

import numpy as np
import torch
from torch import Tensor

from deepir.arrays import Array
from deepir.operators.base import Operator

Slots = Mapping[str, Tensor]


def check_operator(
    operator: Operator, x: Tensor, slots: Slots, *, reference: Callable[[Array, dict[str, Array]], Array] | None = None
) -> None:
    """Check shapes, types, devices, purity, linearity, adjoint, validity and gradients of an operator.

    Args:
        operator: The operator; `Operator.example` gives one with an input and slots.
        x: Input, (N or 1, C, H, W) float64; small, as each of its elements is perturbed.
        slots: Value of each slot, float64. Neither may lie where the operator has a kink.
        reference: Independent implementation `(x, slots) -> y` in numpy; the adjoint is compared with the
            transpose of its dense matrix.

    Raises:
        AssertionError: A property does not hold; with the name of the operator.
    """
    name = type(operator).__name__
    with torch.no_grad():
        y = operator(x, **slots)
        _check_shapes(name, operator, x, slots, y)
        _check_types(name, operator, x, slots)
        _check_purity(name, operator, x, slots, y)
        _check_linearity(name, operator, x, slots)
        _check_validity(name, operator, x, slots, y)
    if operator.affine:
        _check_adjoint(name, operator, x, slots)
    if reference is not None:
        _check_reference(name, operator, x, slots, reference)
    _check_gradients(name, operator, x, slots)


def _check_shapes(name: str, operator: Operator, x: Tensor, slots: Slots, y: Tensor) -> None:
    shape, n_frames = tuple(x.shape), len(y)
    said = operator.out_shape(shape, n_frames)
    _require(tuple(said) == y.shape, f"{name}: out_shape says {tuple(said)}, the output is {tuple(y.shape)}")
    wanted, given = (operator.slots(shape, n_frames), {slot: tuple(value.shape) for slot, value in slots.items()})
    _require(wanted == given, f"{name}: slots() says {wanted}, given are {given}")
    size = operator.in_size((y.shape[-2], y.shape[-1]))
    _require(tuple(size) == x.shape[-2:], f"{name}: in_size says {tuple(size)}, the input is {tuple(x.shape)}")
    _require(operator.neutral.keys() <= wanted.keys(), f"{name}: neutral names a slot that slots() does not")


def _check_types(name: str, operator: Operator, x: Tensor, slots: Slots) -> None:
    devices = ["cpu", *(["cuda"] if torch.cuda.is_available() else [])]
    for device in devices:
        there = copy.deepcopy(operator).to(device)
        for dtype in (torch.float32, torch.float64):
            out = there(x.to(device, dtype), **{slot: v.to(device, dtype) for slot, v in slots.items()})
            _require(out.dtype == dtype, f"{name}: {dtype} became {out.dtype}")
            _require(out.device.type == device, f"{name}: an input on {device} came out on {out.device}")


def _check_purity(name: str, operator: Operator, x: Tensor, slots: Slots, y: Tensor) -> None:
    before = {"x": x.clone(), **{slot: value.clone() for slot, value in slots.items()}}
    operator(x + 1, **slots)
    again = operator(x, **slots)
    _require(torch.equal(again, y), f"{name}: the same input gave another output; is there state?")
    for key, value in {"x": x, **slots}.items():
        _require(torch.equal(before[key], value), f"{name}: {key} was changed in place")


def _check_linearity(name: str, operator: Operator, x: Tensor, slots: Slots) -> None:
    if not operator.affine:
        _require(not operator.linear, f"{name}: linear, but not affine?")
        return
    at_zero = operator(torch.zeros_like(x), **slots)
    if operator.linear:
        _require(not at_zero.any(), f"{name}: A(0) is not 0; set linear = False if it adds something")
    u, v = x, torch.rand(x.shape, dtype=x.dtype, generator=_generator())
    sums = 2 * (operator(u, **slots) - at_zero) - 3 * (operator(v, **slots) - at_zero)
    hint = "A(x) - A(0) is not linear in x; set linear = affine = False if that is meant"
    _require_close(operator(2 * u - 3 * v, **slots) - at_zero, sums, f"{name}: {hint}")


def _check_validity(name: str, operator: Operator, x: Tensor, slots: Slots, y: Tensor) -> None:
    mask = torch.ones_like(x)
    mask[..., x.shape[-2] // 2, x.shape[-1] // 2] = 0
    valid = operator.valid(mask, **slots)
    _require(bool(((valid == 0) | (valid == 1)).all()), f"{name}: valid() gives other numbers than 0 and 1")
    valid = valid.expand_as(y) > 0
    other = operator(x + (1 - mask), **slots)
    message = f"{name}: a sample that is valid depends on an invalid pixel"
    _require_close(other[valid], y[valid], message, tolerance=2e-4)


def _check_adjoint(name: str, operator: Operator, x: Tensor, slots: Slots) -> None:
    shape, linear = tuple(x.shape), operator(x, **slots) - operator(torch.zeros_like(x), **slots)
    y = torch.rand(linear.shape, dtype=x.dtype, generator=_generator())
    back = operator.adjoint(y, shape, **slots)
    _require(back.shape == x.shape, f"{name}: adjoint gives {tuple(back.shape)}, not {shape}")
    _require_close((linear * y).sum(), (x * back).sum(), f"{name}: <A x, y> is not <x, A' y>")


def _check_reference(
    name: str, operator: Operator, x: Tensor, slots: Slots, reference: Callable[[Array, dict[str, Array]], Array]
) -> None:
    arrays = {slot: value.numpy() for slot, value in slots.items()}
    wanted = torch.from_numpy(np.asarray(reference(x.numpy(), arrays), float))
    found = operator(x, **slots)
    _require_close(found, wanted, f"{name}: the forward map is not the reference's")
    if operator.affine:
        at_zero = reference(np.zeros(x.shape), arrays)
        units = np.eye(x.numel()).reshape(-1, *x.shape)
        columns = [(reference(unit, arrays) - at_zero).ravel() for unit in units]
        y = torch.rand(found.shape, dtype=x.dtype, generator=_generator())
        dense = torch.from_numpy(np.stack(columns)) @ y.flatten()
        back = operator.adjoint(y, tuple(x.shape), **slots).flatten()
        _require_close(back, dense, f"{name}: the adjoint is not the transpose of the reference")


def _check_gradients(name: str, operator: Operator, x: Tensor, slots: Slots) -> None:
    def apply(first: Tensor, *rest: Tensor) -> Tensor:
        return operator(first, **dict(zip(slots, rest, strict=True)))

    for chosen in ("x", *slots):
        values = [v.detach().clone().requires_grad_(n == chosen) for n, v in {"x": x, **slots}.items()]
        try:
            torch.autograd.gradcheck(apply, values)
        except RuntimeError as error:
            raise AssertionError(f"{name}: wrong gradient in {chosen}: {error}") from error


def _generator() -> torch.Generator:
    return torch.Generator().manual_seed(1)


def _require(ok: bool, message: str) -> None:
    if not ok:
        raise AssertionError(message)


def _require_close(found: Tensor, wanted: Tensor, message: str, tolerance: float = 1e-9) -> None:
    _require(found.shape == wanted.shape, f"{message}: shape {tuple(found.shape)}, not {tuple(wanted.shape)}")
    if found.numel():
        error, scale = float((found - wanted).abs().max()), max(1.0, float(wanted.abs().max()))
        _require(error <= tolerance * scale, f"{message} (error {error:.2g})")
