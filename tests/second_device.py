"""A second device that computes on the CPU, to run where there is no GPU what a GPU would run.

Its tensors are wrappers that say `meta`, the one device besides the CPU that every build of torch
knows. Each operation is computed by the CPU, and refused, as CUDA refuses it, where tensors of both
devices meet; what branches on "is it the CPU?" takes the GPU's way. Of CUDA's own kernels, and of
their speed, it says nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import torch
from torch.utils import _pytree as pytree
from torch.utils._python_dispatch import TorchDispatchMode

aten = torch.ops.aten
SECOND = torch.device("meta")
_ACROSS = {aten._to_copy.default, aten.copy_.default}
_INDEXING = {
    aten.index.Tensor,
    aten.index_put_.default,
    aten.index_put.default,
    aten._index_put_impl_.default,
}


_tensor = torch.tensor


def _copied_tensor(data: Any, *, device: Any = None, **kwargs: Any) -> torch.Tensor:
    """torch.tensor, which would make an empty one on the device that is called `meta`."""
    made = _tensor(data, **kwargs)
    return made if device is None else made.to(device)


class FarTensor(torch.Tensor):
    """A CPU tensor that says it lies on the second device."""

    held: torch.Tensor
    __torch_function__ = torch._C._disabled_torch_function_impl

    @staticmethod
    def __new__(cls, held: torch.Tensor) -> FarTensor:
        tensor: FarTensor = torch.Tensor._make_wrapper_subclass(  # type: ignore[attr-defined]
            cls,
            held.shape,
            strides=held.stride(),
            storage_offset=held.storage_offset(),
            dtype=held.dtype,
            device=SECOND,
        )
        tensor.held = held
        return tensor

    @classmethod
    def __torch_dispatch__(cls, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        return _computed(func, args, kwargs or {})

    def tolist(self) -> Any:
        """As a CUDA tensor's: copied first."""
        return self.detach().cpu().tolist()

    def new_tensor(self, data: Any, **kwargs: Any) -> torch.Tensor:  # type: ignore[override]
        """As torch's."""
        return _copied_tensor(data, device=SECOND, **{"dtype": self.dtype, **kwargs})

    def __repr__(self) -> str:  # type: ignore[override]
        return f"FarTensor({self.held!r})"


class _Everything(TorchDispatchMode):
    """Sees every operation, those that make tensors from nothing too."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        kwargs = kwargs or {}
        with self:  # inference mode has not yet taken apart what is made of simpler operations
            made = func.decompose(*args, **kwargs)
        return _computed(func, args, kwargs) if made is NotImplemented else made


@contextmanager
def second_device() -> Iterator[None]:
    """Within it tensors can be made on the second device, or copied there."""
    torch.tensor = _copied_tensor
    try:
        with _Everything():
            yield
    finally:
        torch.tensor = _tensor


def _computed(func: Any, args: Any, kwargs: dict[str, Any]) -> Any:
    leaves = pytree.tree_leaves((args, kwargs))
    far = [leaf for leaf in leaves if isinstance(leaf, FarTensor)]
    near = [t for t in leaves if isinstance(t, torch.Tensor) and not isinstance(t, FarTensor)]
    if any(tensor.device == SECOND for tensor in near):
        raise RuntimeError(f"{func}: torch made an index of a list; the stand-in needs a tensor")
    strangers = [tensor for tensor in near if tensor.dim() > 0]
    if far and strangers and func not in _ACROSS:
        by_index = func in _INDEXING and isinstance(args[0], FarTensor)
        if not (by_index and all(tensor.dtype == torch.long for tensor in strangers)):
            raise RuntimeError(f"{func}: tensors on the second device and on the CPU")
    wanted = kwargs.get("device")
    goes_far = bool(far) if wanted is None else torch.device(wanted) == SECOND
    if func == aten.copy_.default:
        goes_far = isinstance(args[0], FarTensor)

    def bare(leaf: Any) -> Any:
        return leaf.held if isinstance(leaf, FarTensor) else leaf

    own_args, own_kwargs = pytree.tree_map(bare, (args, kwargs))
    if wanted is not None:
        own_kwargs["device"] = torch.device("cpu")
        own_kwargs.pop("pin_memory", None)
    out = func(*own_args, **own_kwargs)
    given = {id(leaf.held): leaf for leaf in far}  # an operation in place gives its own back

    def wrapped(leaf: Any) -> Any:
        if not isinstance(leaf, torch.Tensor):
            return leaf
        return given[id(leaf)] if id(leaf) in given else FarTensor(leaf)

    return pytree.tree_map(wrapped, out) if goes_far else out
