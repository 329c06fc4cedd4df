# SPDX-License-Identifier: MIT
"""Steps of a fused optimiser of torch, which it can skip on the device.

This is the only module that uses this interface, which torch keeps for its own gradient scaler: a
fused optimiser skips a step if its attribute `found_inf` is not 0.
"""

from __future__ import annotations

from torch import Tensor
from torch.optim import Optimizer


def is_fused(optimiser: Optimizer) -> bool:
    """Return whether an optimiser takes a step in one kernel on the device."""
    return bool(optimiser.defaults["fused"])


def skip_step(optimiser: Optimizer, is_skipped: Tensor) -> None:
    """Have a fused optimiser skip its next step, or take it, without waiting for the device.

    Parameters
    ----------
    optimiser : Optimizer
        Fused optimiser.
    is_skipped : Tensor of bool, 0-d
        Whether it skips the step, on the device of the parameters.
    """
    vars(optimiser).update(grad_scale=None, found_inf=is_skipped.float())
