# SPDX-License-Identifier: MIT
"""Ray clusters on this machine; all tests of a process share one."""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from salsanext_cli.runs.loop.cluster.worker_size import MAX_CORES_PER_WORKER

TESTS = Path(__file__).parents[3]


@contextmanager
def cluster_of_head(cores: int) -> Iterator[Any]:
    """Start a cluster whose head claims some cores; its workers import modules of the tests."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join([str(TESTS.parent), str(TESTS), *sys.path]))
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        # Each of these is a further process of Python.
        head = {"include_dashboard": False, "include_log_monitor": False, "no_monitor": True}
        started = Cluster(initialize_head=True, head_node_args=head | {"num_cpus": cores})
        try:
            yield started
        finally:
            started.shutdown()


@pytest.fixture(scope="session")
def cluster() -> Iterator[Any]:
    """Return a cluster whose head has room for two workers."""
    with cluster_of_head(2 * MAX_CORES_PER_WORKER) as started:
        yield started


@pytest.fixture
def cluster_of_one() -> Iterator[Any]:
    """Return a cluster of one node that the test may kill."""
    with cluster_of_head(1) as started:
        yield started
