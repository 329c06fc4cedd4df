# SPDX-License-Identifier: MIT
"""Batch norm over the images of all workers of a team, on any device.

torch's own `SyncBatchNorm` knows GPUs only.
"""

from __future__ import annotations

from typing import Any

import torch
import torch.distributed as dist
from torch import Tensor, nn
from torch.autograd.function import once_differentiable


class SumOverTeam(torch.autograd.Function):
    """The sum of the tensors of all workers, with a gradient.

    What a worker gives goes into the loss of each, so its gradient is the sum of theirs.
    """

    @staticmethod
    def forward(ctx: Any, own: Tensor) -> Tensor:
        """Add up the tensors of all workers."""
        total = own.clone()
        dist.all_reduce(total)
        return total

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, gradient: Tensor) -> Tensor:
        """Add up the gradients of all workers."""
        total = gradient.contiguous().clone()
        dist.all_reduce(total)
        return total


def add_up(own: Tensor) -> Tensor:
    """Return the sum of the tensors of all workers."""
    total: Tensor = SumOverTeam.apply(own)  # type: ignore[no-untyped-call]
    return total


class TeamBatchNorm(nn.BatchNorm2d):
    """`BatchNorm2d` whose statistics, in training, are those of the batches of all workers."""

    def forward(self, input: Tensor) -> Tensor:
        """Normalise (B, C, H, W); every worker must come here, with at least one image."""
        if not self.training:
            return super().forward(input)
        # Sums over an image do not fit into shorter types.
        values = input.to(torch.promote_types(input.dtype, torch.float32))
        count = add_up(values.new_tensor(values.numel() / values.shape[1]))
        mean = add_up(values.sum((0, 2, 3))) / count
        centred = values - mean[:, None, None]
        variance = add_up(centred.square().sum((0, 2, 3))) / count
        self._track(mean.detach(), variance.detach() * count / (count - 1))
        scale = (self.weight * torch.rsqrt(variance + self.eps))[:, None, None]
        return (centred * scale + self.bias[:, None, None]).to(input.dtype)

    @torch.no_grad()
    def _track(self, mean: Tensor, variance: Tensor) -> None:
        """Move the running statistics as `BatchNorm2d` does."""
        assert self.running_mean is not None
        assert self.running_var is not None
        assert self.num_batches_tracked is not None
        assert self.momentum is not None
        self.num_batches_tracked += 1
        self.running_mean.lerp_(mean, self.momentum)
        self.running_var.lerp_(variance, self.momentum)


def with_team_norm(module: nn.Module) -> nn.Module:
    """Return a module with all its batch norms made `TeamBatchNorm`, weights and names kept."""
    for name, child in module.named_children():
        setattr(module, name, with_team_norm(child))
    if type(module) is not nn.BatchNorm2d:
        return module
    norm = TeamBatchNorm(module.num_features, module.eps, module.momentum)
    # The tensors themselves, not copies: others hold them too.
    norm._parameters, norm._buffers = module._parameters, module._buffers
    return norm.train(module.training)
