# SPDX-License-Identifier: MIT
"""Calls of torch in which the host waits for the device, which no CUDA graph can record."""

from collections.abc import Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode
from torch.utils._pytree import tree_leaves

aten = torch.ops.aten
HOST_TAGS = {torch.Tag.data_dependent_output, torch.Tag.dynamic_output_shape}
INDEXED = {aten.index, aten.index_put, aten.index_put_}  # Their sizes depend on data with a mask


class HostUseRefused(TorchDispatchMode):  # type: ignore[no-untyped-call]
    """Context of one thread in which a call raises `RuntimeError` if the host must wait for it.

    Such calls read values, such as `Tensor.item`, return as many as the values decide, such as
    `torch.nonzero`, or copy between devices.
    """

    def __torch_dispatch__(
        self,
        func: Any,
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        """Call a function of torch, or the functions that it is made of."""
        named = kwargs or {}
        if _depends_on_values(func, args):
            raise RuntimeError(f"{func} needs the host")
        with self:
            result = func.decompose(*args, **named)
        if result is NotImplemented:
            result = func(*args, **named)
        tensors = [leaf for leaf in tree_leaves((args, named, result)) if isinstance(leaf, Tensor)]
        if len({tensor.device for tensor in tensors}) > 1:
            raise RuntimeError(f"{func} copies between devices")
        return result


def _depends_on_values(func: Any, args: tuple[Any, ...]) -> bool:
    """Return whether the host must know values to return from a function of torch."""
    if func.overloadpacket in INDEXED:
        indices = [index for index in args[1] if index is not None]
        return any(index.dtype in (torch.bool, torch.uint8) for index in indices)
    return not HOST_TAGS.isdisjoint(func.tags)
