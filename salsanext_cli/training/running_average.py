# SPDX-License-Identifier: MIT
"""Running average of the weights of a network in training."""

import torch
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn


class RunningAverage:
    """Running average of weights and of the statistics of batch norm.

    The tensors of both modules are found once, since finding them takes longer than the update.

    Parameters
    ----------
    average : Module
        Module that moves.
    module : Module
        Module in training, of the same structure.
    decay : float
        Share of the average that a step keeps, 0…1.
    """

    def __init__(self, average: nn.Module, module: nn.Module, decay: float) -> None:
        self.decay = decay
        states = zip(average.state_dict().values(), module.state_dict().values(), strict=True)
        pairs = list(states)
        floating = [pair for pair in pairs if pair[0].is_floating_point()]
        self.averages = [old for old, _ in floating]
        self.values = [new for _, new in floating]
        counts = [pair for pair in pairs if not pair[0].is_floating_point()]
        self.old_counts = [old for old, _ in counts]
        self.counts = [new for _, new in counts]

    @torch.no_grad()
    def update(self, step: int) -> None:
        """Move the average towards the module after a step, counted from 0."""
        # The first steps move it farther, so that the initial weights soon lose their influence.
        decay = min(self.decay, (1 + step) / (10 + step))
        update = get_ema_multi_avg_fn(decay)  # type: ignore[no-untyped-call]
        update(self.averages, self.values, None)
        if self.counts:
            torch._foreach_copy_(self.old_counts, self.counts)
