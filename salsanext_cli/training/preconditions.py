# SPDX-License-Identifier: MIT
"""What a training needs before it begins: samples for every worker, and memory for a step."""

from functools import partial

import torch

from salsanext_cli.core.errors import UsageError
from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.memory import memory_of
from salsanext_cli.training.step_memory import StepMemory


def require_memory(step: StepMemory | None, group: ProcessGroup, device: torch.device) -> None:
    """Refuse or warn of a step that needs more memory than the device has."""
    memory = memory_of(str(device))
    if step and memory:
        group.on_main(partial(step.require_fits, memory))


def require_batch(samples: int, group: ProcessGroup) -> None:
    """Refuse a batch with fewer samples than workers."""
    if samples < group.size:
        expected = f"at least one sample for each of {group.size} workers"
        hint = "start fewer workers or set batch higher"
        error = UsageError("recipe key batch", f"is {samples}", expected, hint)
        error.reported_elsewhere = not group.is_main
        raise error
