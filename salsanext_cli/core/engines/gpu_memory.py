# SPDX-License-Identifier: MIT
"""GPUs that the workers of a run use, and processes that fit into their free memory."""

CONTEXT_BYTES = 1_000_000_000
"""Memory of CUDA and its libraries in each process, which torch does not count."""


def gpus_of_workers(device: str) -> int:
    """Return the number of GPUs that workers share: all of them unless the device has a number."""
    import torch

    return max(1, torch.cuda.device_count()) if device == "cuda" else 1


def processes_in_memory(device: str) -> int:
    """Return the number of processes like this one that fit into the memory of a device.

    Other GPUs count as one like that of this process.

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
        fitting = processes_that_fit(free, torch.cuda.max_memory_reserved())
    return fitting * gpus_of_workers(device)


def processes_that_fit(free_bytes: int, process_bytes: int) -> int:
    """Return how many processes fit into free memory, each with its context beside its tensors."""
    return free_bytes // (process_bytes + CONTEXT_BYTES)
