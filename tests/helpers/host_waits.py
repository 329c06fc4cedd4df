# SPDX-License-Identifier: MIT
"""Calls for which the host of a GPU waits, found on a machine without one.

Tensors of the device "meta", which takes the place of the GPU, have shapes but no values. So torch
itself refuses to read them.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from salsanext_cli.core.engines.host_use import FROM_NUMBERS, HostUseRefused, TorchCall, tensors_in

META = torch.device("meta")


class WaitsRefused(HostUseRefused):
    """Context in which a call raises `RuntimeError` if the host must wait for device "meta".

    Other than a call that is recorded, it may copy from pinned memory of the host without waiting.

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
        args: tuple[Any, ...] = (),
        kwargs: Mapping[str, Any] | None = None,
    ) -> Any:
        if func.__name__ == "pin_memory":
            self.pinned.append(args[0])
            return args[0]
        return super().__torch_function__(func, types, args, kwargs)

    def reads(self, call: TorchCall) -> bool:
        """Return whether a call depends on values of the device."""
        return super().reads(call) and _any_on_meta(call.tensors)

    def copies(self, call: TorchCall, result: Any) -> bool:
        """Return whether a call copied to the device, and waited."""
        if not _any_on_meta([*call.tensors, *tensors_in(result)]):
            return False
        return call.name in FROM_NUMBERS or any(
            not (call.named.get("non_blocking") and self._is_pinned(tensor))
            for tensor in call.tensors
            # Kernels take a single number as an argument.
            if tensor.device.type == "cpu" and tensor.ndim
        )

    def _is_pinned(self, tensor: Tensor) -> bool:
        memory = tensor.untyped_storage().data_ptr()
        return any(memory == other.untyped_storage().data_ptr() for other in self.pinned)


def _any_on_meta(tensors: Iterable[Tensor]) -> bool:
    return any(tensor.device == META for tensor in tensors)
