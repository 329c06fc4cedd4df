# SPDX-License-Identifier: MIT
"""Workers of a size that every node has room for."""

import pytest

from salsanext_cli.runs.loop.cluster.worker_size import (
    MAX_CORES_PER_GPU,
    MAX_CORES_PER_WORKER,
    Node,
    WorkerSize,
)

GB = 1_000_000_000


def node(cores, gpus=0, memory=1000):
    """Return a node; `memory`: in GB."""
    size = int(memory * GB)
    return Node(id="id", name="name", cores=cores, gpus=gpus, memory=size)


@pytest.mark.parametrize(
    ("nodes", "places"),
    [
        ([node(16), node(64)], [4, 16]),
        # A head without cores has no workers, and a small node does not decide for all.
        ([node(0), node(2), node(9)], [0, 0, 3]),
        ([node(4, 2), node(3)], [1, 1]),
        ([node(1), node(1), node(2)], [1, 1, 2]),
        ([node(1), node(64)], [0, 16]),
        ([node(6), node(6)], [2, 2]),
        # Memory bounds them too.
        ([node(16, memory=2.5), node(16, memory=0.5)], [2, 0]),
    ],
)
def test_workers_without_a_gpu_share_the_cores(nodes, places):
    size = WorkerSize.fitting(nodes, uses_gpu=False, memory=GB)
    assert size.cores <= MAX_CORES_PER_WORKER
    assert size.gpus == 0
    assert [size.places(node) for node in nodes] == places


def test_most_gpus_have_a_worker_with_their_share_of_the_cores():
    nodes = [node(64, 8), node(16, 4), node(8)]
    size = WorkerSize.fitting(nodes, uses_gpu=True, memory=GB)
    assert size == WorkerSize(cores=8, gpus=1, memory=GB)
    assert [size.places(node) for node in nodes] == [8, 2, 0]
    assert size.places(node(64, 8, memory=3)) == 3
    assert str(size) == "a GPU, 8 cores and 1.0 GB of memory"
    # A small node does not decide for all, unless it has more than a quarter of the GPUs.
    for nodes, cores in (([node(64, 8), node(1, 1)], 8), ([node(32, 8), node(8, 8)], 2)):
        assert WorkerSize.fitting(nodes, uses_gpu=True, memory=GB).cores == cores
    assert WorkerSize.fitting([node(0, 2)], uses_gpu=True, memory=GB).cores == 1


def test_a_cluster_that_has_no_nodes_yet_gets_the_largest_workers():
    assert WorkerSize.fitting([], uses_gpu=False, memory=GB).cores == MAX_CORES_PER_WORKER
    assert WorkerSize.fitting([node(4)], uses_gpu=True, memory=GB).cores == MAX_CORES_PER_GPU


def test_workers_that_need_more_memory_are_fewer():
    nodes = [node(16, memory=5.0), node(16, memory=2.0)]
    size = WorkerSize.fitting(nodes, uses_gpu=False, memory=2_500_000_000)
    assert [size.places(node) for node in nodes] == [2, 0]
    assert str(size) == "4 cores and 2.5 GB of memory"
