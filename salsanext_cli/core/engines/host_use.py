# SPDX-License-Identifier: MIT
"""Calls of torch in which the host waits for the device, which no CUDA graph can record."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
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
"""Functions for which the host is needed if an index is a mask, or numbers of the host."""
FROM_NUMBERS = {"as_tensor", "asarray", "new_tensor", "tensor"}  # Copies from the host


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorchCall:
    """Call of a function of torch.

    Attributes
    ----------
    name : str
        Name of the function.
    args : sequence
        Its arguments by position.
    named : mapping
        Its arguments by name.
    """

    name: str
    args: Sequence[Any]
    named: Mapping[str, Any]

    @property
    def tensors(self) -> list[Tensor]:
        """Tensors among the arguments."""
        return [*tensors_in([self.args, self.named])]

    def depends_on_values(self) -> bool:
        """Return whether the host must have values of tensors or indices before the call."""
        count = len(self.args) + len(self.named)
        if self.name in INDEXED:
            return any(map(_needs_host, [*self.args[1:2], self.named.get("indices")]))
        if self.name == "where":
            return count == 1
        if self.name == "repeat_interleave":
            if self.named.get("output_size") is not None:
                return False
            return count == 1 or next(tensors_in([self.args[1:], self.named]), None) is not None
        return self.name in READS or self.name in SIZED_BY_VALUES


class HostUseRefused(TorchFunctionMode):
    """Context of one thread in which a call raises `RuntimeError` if it needs the host.

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
        call = TorchCall(name=func.__name__, args=args, named=kwargs or {})
        if self.reads(call):
            raise RuntimeError(f"{call.name} needs the host")
        result = func(*call.args, **call.named)
        if self.copies(call, result):
            raise RuntimeError(f"{call.name} copies between devices")
        return result

    def reads(self, call: TorchCall) -> bool:
        """Return whether a call is refused because it depends on values."""
        return call.depends_on_values()

    def copies(self, call: TorchCall, result: Any) -> bool:
        """Return whether a call is refused because it copied between devices."""
        devices = {tensor.device.type for tensor in [*call.tensors, *tensors_in(result)]}
        return len(devices) > 1 or (call.name in FROM_NUMBERS and devices != {"cpu"})


def _needs_host(index: Any) -> bool:
    """Return whether an index, or a member of it, is a mask or has numbers of the host."""
    if isinstance(index, Tensor):
        return index.dtype in (torch.bool, torch.uint8)
    if isinstance(index, tuple) or next(tensors_in(index), None) is not None:
        return any(map(_needs_host, index))
    return isinstance(index, list | np.ndarray)


def tensors_in(values: Any) -> Iterator[Tensor]:
    """Yield the tensors in nested sequences and mappings."""
    if isinstance(values, Tensor):
        yield values
    elif isinstance(values, Mapping):
        yield from tensors_in(list(values.values()))
    elif isinstance(values, list | tuple):
        for value in values:
            yield from tensors_in(value)
