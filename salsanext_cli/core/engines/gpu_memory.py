# SPDX-License-Identifier: MIT
"""Processes that fit into the free memory of a GPU."""

CONTEXT_BYTES = (
    1_000_000_000  # Of CUDA and its libraries in each process, which torch does not count
)


def processes_in_memory(device: str) -> int:
    """Return the number of processes like this one that fit into the free memory of a GPU.

    Parameters
    ----------
    device : str
        ``"cuda"``, ``"cuda:1"`` …

    Returns
    -------
    int
    """
    import torch

    with torch.cuda.device(device):
        free, _ = torch.cuda.mem_get_info()
        return processes_that_fit(free, torch.cuda.max_memory_reserved())


def processes_that_fit(free_bytes: int, process_bytes: int) -> int:
    """Return how many processes fit into free memory, each with its context beside its tensors."""
    return free_bytes // (process_bytes + CONTEXT_BYTES)
