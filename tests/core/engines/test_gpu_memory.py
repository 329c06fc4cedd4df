# SPDX-License-Identifier: MIT
"""Processes that fit into the memory of a GPU."""

import pytest

from salsanext_cli.core.engines.gpu_memory import processes_that_fit

GB = 10**9


@pytest.mark.parametrize(
    ("free", "process", "expected"),
    [(8 * GB, 1 * GB, 4), (8 * GB - 1, 1 * GB, 3), (140 * GB, 2 * GB, 46), (GB, GB, 0)],
)
def test_each_process_has_a_context(free, process, expected):
    assert processes_that_fit(free, process) == expected
