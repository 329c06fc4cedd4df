# SPDX-License-Identifier: MIT
"""Ray clusters on this machine; all tests of a process share one."""

import os
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from time_limits import time_limit

from salsanext_cli.runs.loop.cluster.worker_size import MAX_CORES_PER_WORKER

MAX_STARTS = 3
MAX_TEST_S = 300.0  # With the start of a cluster, on a machine with much other work
REAL_CLUSTERS = frozenset({"cluster", "cluster_of_one", "two_nodes"})  # Fixtures
TESTS = Path(__file__).parents[3]


@pytest.hookimpl(wrapper=True)
def pytest_runtest_protocol(item: pytest.Item) -> Iterator[Any]:
    """Let a test on a real cluster fail that takes too long, its fixtures included."""
    if not REAL_CLUSTERS.intersection(getattr(item, "fixturenames", ())):
        return (yield)
    with time_limit(MAX_TEST_S):
        return (yield)


@contextmanager
def sigterm_kept() -> Iterator[None]:
    """Let SIGTERM end this process also after the start of a node.

    The handler of Ray raises `SystemExit`, which is a failure of one test for pytest, and ignores
    all further signals.
    """
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def node_started(start: Callable[[], Any]) -> Any:
    """Call a function that starts a node, again if the node does not come up.

    Ray ends a node whose agents, processes of Python, take more than 15 s to start: on a machine
    with much other work some do.
    """
    with sigterm_kept():
        for _ in range(MAX_STARTS - 1):
            with suppress(Exception):
                return start()
        return start()


@contextmanager
def cluster_of_head(cores: int) -> Iterator[Any]:
    """Start a cluster whose head claims some cores; its workers import modules of the tests."""
    pytest.importorskip("ray")
    from ray.cluster_utils import Cluster

    with pytest.MonkeyPatch.context() as patch:
        patch.setenv(
            "PYTHONPATH", os.pathsep.join([str(TESTS.parent), str(TESTS / "helpers"), *sys.path])
        )
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        # Otherwise each process of Ray compiles its modules, and agents start too late under load.
        patch.delenv("PYTHONDONTWRITEBYTECODE", raising=False)
        head: dict[str, Any] = {
            "num_cpus": cores,
            # Each of these is a further process of Python.
            "include_dashboard": False,
            "include_log_monitor": False,
            "no_monitor": True,
        }
        started = node_started(lambda: Cluster(initialize_head=True, head_node_args=head))
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
def extra_node(cluster: Any) -> Iterator[Any]:
    """Return a function that adds a node with room for one worker, which the test may remove."""
    added = []

    def add(**options: Any) -> Any:
        options = {"num_cpus": MAX_CORES_PER_WORKER, "include_log_monitor": False, **options}
        node = node_started(lambda: cluster.add_node(**options))
        added.append(node)
        return node

    yield add
    for node in added:
        if node in cluster.worker_nodes:
            cluster.remove_node(node)


@pytest.fixture
def cluster_of_one() -> Iterator[Any]:
    """Return a cluster of one node that the test may kill."""
    with cluster_of_head(1) as started:
        yield started


@pytest.fixture
def two_nodes() -> Iterator[Any]:
    """Return a cluster of two nodes with room for one small worker each."""
    with cluster_of_head(1) as started:
        node_started(lambda: started.add_node(num_cpus=1, include_log_monitor=False))
        yield started
