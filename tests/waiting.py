# SPDX-License-Identifier: MIT
"""Calls for which the host of a GPU waits, found on a machine without one.

Tensors of the device "meta" have shapes but no values, so torch itself refuses to read them. It
does not refuse copies to them that wait, and those are refused here.
"""

from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode

META = torch.device("meta")
COPIES_OF_NUMBERS = {"tensor", "as_tensor", "asarray", "new_tensor"}
"""Functions that copy numbers of the host from memory that is not pinned."""
READERS = {"bincount", "histogram", "masked_select", "nonzero", "argwhere", "unique", "item"}
"""Functions whose results have a size that the host reads."""
SUBSCRIPTS = {"__getitem__", "__setitem__"}


class NoWaiting(TorchFunctionMode):
    """Refuse calls for which the host of a GPU would wait; "meta" takes the place of the GPU.

    Parameters
    ----------
    pinned : iterable of Tensor
        Tensors of the host in pinned memory, beside those that are pinned meanwhile.
    """

    def __init__(self, pinned: Iterable[Tensor] = ()) -> None:
        super().__init__()
        self.pinned = list(pinned)

    def __torch_function__(
        self,
        func: Callable[..., Any],
        types: Sequence[type],
        args: Sequence[Any] = (),
        kwargs: dict[str, Any] | None = None,
    ) -> Any:
        kwargs = kwargs or {}
        name = getattr(func, "__name__", "")
        if name == "pin_memory":
            self.pinned.append(args[0])
            return args[0]
        result = func(*args, **kwargs)
        operands = [value for value in (*args, *kwargs.values()) if isinstance(value, Tensor)]
        is_there = any(tensor.device == META for tensor in operands)
        if is_there and name in READERS:
            raise AssertionError(f"{name} reads from the device")
        if is_there and name in SUBSCRIPTS and _is_of_host(args[1]):
            raise AssertionError("an index of the host is copied, and waits")
        if isinstance(result, Tensor) and result.device == META:
            self._require_pinned(name, operands, kwargs)
        return result

    def _require_pinned(self, name: str, operands: list[Tensor], kwargs: dict[str, Any]) -> None:
        """Raise an error if a call copies from memory of the host and waits."""
        if name in COPIES_OF_NUMBERS:
            raise AssertionError(f"torch.{name} copies numbers, and waits")
        for tensor in operands:
            # Kernels take a single number as an argument.
            if tensor.device.type == "cpu" and tensor.ndim:
                is_pinned = any(_share_memory(tensor, other) for other in self.pinned)
                if not (is_pinned and kwargs.get("non_blocking")):
                    raise AssertionError(f"{name} copies {tuple(tensor.shape)}, and waits")


def _share_memory(one: Tensor, other: Tensor) -> bool:
    return one.untyped_storage().data_ptr() == other.untyped_storage().data_ptr()


def _is_of_host(index: Any) -> bool:
    """Return whether an index, or a member of it, is an array of the host."""
    members = index if isinstance(index, tuple) else (index,)
    return any(
        isinstance(member, list | np.ndarray)
        or (isinstance(member, Tensor) and member.device.type == "cpu" and member.ndim > 0)
        for member in members
    )
