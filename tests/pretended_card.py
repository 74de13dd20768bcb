"""A device `card` that computes on the CPU, and is as strict as a GPU about what lies where.

Its tensors hold their values in the CPU's memory. An operation on tensors of both devices raises as it does on a GPU,
and so does `numpy()`. So whole solves run on it, and give the bits of the same operations on the CPU.
"""

import torch
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils.backend_registration import _DummyBackendModule, _setup_privateuseone_for_python_backend

aten = torch.ops.aten
#: Operations that take tensors of both devices: copies, and those whose indices may be on the CPU.
BETWEEN_DEVICES = {aten.copy_.default, aten._to_copy.default, aten._local_scalar_dense.default}
INDEXED = {aten.index.Tensor, aten.index_put.default, aten.index_put_.default, aten._index_put_impl_.default}
#: Operations that take no number of the CPU, a tensor without axes, beside tensors of the card.
WITHOUT_NUMBERS = {aten.cat.default, aten.stack.default}
_LIBRARY = torch.library.Library("_", "IMPL")


class OnCard(torch.Tensor):
    """A tensor on the card; `held` has its values."""

    @staticmethod
    def __new__(cls, held):
        layout = {"strides": held.stride(), "storage_offset": held.storage_offset(), "dtype": held.dtype}
        return torch.Tensor._make_wrapper_subclass(cls, held.shape, **layout, device="card:0")

    def __init__(self, held):
        self.held = held

    def __repr__(self):
        return f"OnCard({self.held!r})"

    def tolist(self):
        return self.held.tolist()

    def numpy(self, *, force=False):
        if not force:
            raise TypeError("a tensor of the card has no numpy(); cpu() comes first")
        return self.held.numpy(force=True)

    # So that `module.double()` puts a new tensor in the place of the old one, and does not change its type alone.
    def __tensor_flatten__(self):
        return ["held"], None

    @staticmethod
    def __tensor_unflatten__(inner, *_):
        return OnCard(inner["held"])

    @classmethod
    def __torch_dispatch__(cls, operation, types, args=(), kwargs=None):
        return _compute(operation, args, kwargs or {})


class Card(TorchDispatchMode):
    """Within it, `device="card"` makes tensors on the card."""

    def __enter__(self):
        torch._C._set_only_lift_cpu_tensors(True)  # so that `torch.tensor(..., device="card")` comes by here
        return super().__enter__()

    def __exit__(self, *error):
        torch._C._set_only_lift_cpu_tensors(False)
        return super().__exit__(*error)

    def __torch_dispatch__(self, operation, types, args=(), kwargs=None):
        return _compute(operation, args, kwargs or {})


def install():
    """Make the device known to torch: once in a process, and before its first gradient."""
    module = _DummyBackendModule()
    module.get_amp_supported_dtype = lambda: [torch.bfloat16]
    _setup_privateuseone_for_python_backend("card", backend_module=module)
    # Autocast does nothing on it.
    _LIBRARY.fallback(torch.library.fallthrough_kernel, "AutocastPrivateUse1")


def _compute(operation, args, kwargs):
    given = [*_tensors(args), *_tensors(kwargs.values())]
    on_card = any(isinstance(each, OnCard) for each in given)
    if on_card:
        _demand_one_device(operation, given)
    if (target := kwargs.get("device")) is not None:
        on_card = torch.device(target).type == "card"
        kwargs = {**kwargs, "device": torch.device("cpu")}
    found = operation(*(_held(each) for each in args), **{name: _held(each) for name, each in kwargs.items()})
    if operation._schema.is_mutable:
        return args[0] if found is _held(args[0]) else _on_card(found) if on_card else found
    return _on_card(found) if on_card and operation is not aten._local_scalar_dense.default else found


def _demand_one_device(operation, given):
    """Raise as a GPU does; it takes numbers of the CPU, and indices."""
    strangers = [each for each in given if not isinstance(each, OnCard)]
    wrong = [each for each in strangers if each.ndim or operation in WITHOUT_NUMBERS]
    if operation in INDEXED and isinstance(given[0], OnCard):
        wrong = []
    if wrong and operation not in BETWEEN_DEVICES:
        raise RuntimeError(f"{operation}: a tensor {tuple(wrong[0].shape)} of the CPU among those of the card")


def _tensors(values):
    for each in values:
        if isinstance(each, torch.Tensor):
            yield each
        elif isinstance(each, list | tuple):
            yield from _tensors(each)


def _held(value):
    if isinstance(value, OnCard):
        return value.held
    return type(value)(map(_held, value)) if isinstance(value, list | tuple) else value


def _on_card(value):
    if isinstance(value, torch.Tensor):
        # A lazy conjugate is marked as one, and operations below this do not look at the mark.
        return OnCard(value.resolve_conj().resolve_neg())
    return type(value)(map(_on_card, value)) if isinstance(value, list | tuple) else value
