# SPDX-License-Identifier: MIT
"""Number type of a training: which the devices compute fast, and what stays float32."""

import torch
from torch import Tensor, nn

from salsanext_cli.engines.device import PRECISIONS, has_bfloat16
from salsanext_cli.engines.graphs import LOGITS
from salsanext_cli.records import CHANNELS
from salsanext_cli.training.distributed import ProcessGroup

BFLOAT16_CAPABILITY = 8
"""Lowest compute capability (major) of GPUs that compute in bfloat16: Ampere."""


def choose_precision(name: str, device: torch.device) -> str:
    """Return the number type behind a recipe's `precision` on a device.

    "auto" is bfloat16 on a CPU that multiplies it and on a GPU, float16 on a GPU too old for that,
    and float32 on other CPUs.
    """
    if name != "auto":
        return name
    if device.type != "cuda":
        return "bfloat16" if has_bfloat16() else "float32"
    major, _ = torch.cuda.get_device_capability(device)
    return "bfloat16" if major >= BFLOAT16_CAPABILITY else "float16"


def common_precision(device: torch.device, group: ProcessGroup) -> str:
    """Return the number type that suits the devices of all workers; float32 if they differ."""
    own = choose_precision("auto", device)
    chosen = group.gather(torch.tensor([PRECISIONS.index(own)], device=device))
    return own if len({int(number) for number in chosen}) == 1 else "float32"


class Float32Convolution(nn.Conv2d):
    """Convolution that autocast leaves alone."""

    def forward(self, x: Tensor) -> Tensor:
        """Compute in float32, from features of any type."""
        with torch.autocast(x.device.type, enabled=False):
            return super().forward(x.float())


def keep_ends_in_float32(module: nn.Module) -> None:
    """Keep the layers of the range image and of the logits in float32, as `in_precision` does."""
    for name, layer in module.named_modules():
        if type(layer) is nn.Conv2d and (name == LOGITS or layer.in_channels == len(CHANNELS)):
            # The same tensors under the same names; a new layer would need copies of them.
            layer.__class__ = Float32Convolution
