# SPDX-License-Identifier: MIT
"""Processes that fit into the memory of a GPU."""

from contextlib import nullcontext

import pytest

from salsanext_cli.core.engines.gpu_memory import (
    gpus_of_workers,
    processes_in_memory,
    processes_that_fit,
)

GB = 10**9


@pytest.mark.parametrize(
    ("free", "process", "expected"),
    [(8 * GB, 1 * GB, 4), (8 * GB - 1, 1 * GB, 3), (140 * GB, 2 * GB, 46), (GB, GB, 0)],
)
def test_each_process_has_a_context(free, process, expected):
    assert processes_that_fit(free, process) == expected


@pytest.mark.parametrize(("device", "gpus"), [("cuda", 3), ("cuda:0", 1), ("cuda:2", 1)])
def test_workers_share_all_gpus_unless_one_is_named(monkeypatch, device, gpus):
    monkeypatch.setattr("torch.cuda.device_count", lambda: 3)
    monkeypatch.setattr("torch.cuda.device", lambda _: nullcontext())
    monkeypatch.setattr("torch.cuda.mem_get_info", lambda: (8 * GB, 9 * GB))
    monkeypatch.setattr("torch.cuda.max_memory_reserved", lambda: GB)
    assert gpus_of_workers(device) == gpus
    assert processes_in_memory(device) == 4 * gpus
