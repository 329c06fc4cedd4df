# SPDX-License-Identifier: MIT
"""Calls of torch in which the host waits for the device, which no CUDA graph can record."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

READS = {
    "__array__",
    "__bool__",
    "__complex__",
    "__contains__",
    "__float__",
    "__index__",
    "__int__",
    "allclose",
    "equal",
    "is_nonzero",
    "item",
    "numpy",
    "tolist",
}
"""Functions that return values of a tensor."""
SIZED_BY_VALUES = {
    "argwhere",
    "bincount",
    "masked_select",
    "nonzero",
    "unique",
    "unique_consecutive",
}
"""Functions whose results have as many values as the values of a tensor decide."""
INDEXED = {"__getitem__", "__setitem__", "index_put", "index_put_"}
"""Functions of which this holds if an index is a mask."""
FROM_NUMBERS = {"as_tensor", "new_tensor", "tensor"}  # Copies from the host


class HostUseRefused(TorchFunctionMode):
    """Context of one thread in which a call raises `RuntimeError` if the host must wait for it.

    Such calls read values, such as `Tensor.item`, return as many as the values decide, such as
    `torch.nonzero`, or copy between devices. Calls from Python are seen, not those within them.
    """

    def __torch_function__(
        self,
        func: Any,
        types: Sequence[type],
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        """Call a function of torch."""
        named = kwargs or {}
        name = func.__name__
        if depends_on_values(name, args, named):
            raise RuntimeError(f"{name} needs the host")
        result = func(*args, **named)
        devices = {tensor.device.type for tensor in tensors_in([args, named, result])}
        if len(devices) > 1 or (name in FROM_NUMBERS and devices != {"cpu"}):
            raise RuntimeError(f"{name} copies between devices")
        return result


def depends_on_values(name: str, args: Sequence[Any], named: Mapping[str, Any]) -> bool:
    """Return whether the host must know values to return from a function of torch.

    Parameters
    ----------
    name : str
        Name of the function.
    args : sequence
        Its arguments by position.
    named : mapping
        Its arguments by name.

    Returns
    -------
    bool
    """
    if name in INDEXED:
        indices = tensors_in([args[1:2], named])
        return any(index.dtype in (torch.bool, torch.uint8) for index in indices)
    if name == "where":
        return len(args) + len(named) == 1
    if name == "repeat_interleave":
        return len(args) + len(named) == 1 or next(tensors_in([args[1:], named]), None) is not None
    return name in READS or name in SIZED_BY_VALUES


def tensors_in(values: Any) -> Iterator[Tensor]:
    """Yield the tensors in nested sequences and mappings."""
    if isinstance(values, Tensor):
        yield values
    elif isinstance(values, Mapping):
        yield from tensors_in(list(values.values()))
    elif isinstance(values, list | tuple):
        for value in values:
            yield from tensors_in(value)
