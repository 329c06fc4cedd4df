# SPDX-License-Identifier: MIT
"""Which calls are recorded, and what becomes of those that cannot be.

`tests/cuda` compares recorded calls with plain ones.
"""

from itertools import cycle

import pytest
import torch

from salsanext_cli.core.engines import cuda_graphs
from salsanext_cli.core.engines.cuda_graphs import MAX_GRAPHS, CudaGraphs


def squares(x):
    return x * x, x.sum()


TIMES = cycle([1.0, 0.8])  # Of a plain call, and of a replayed one


class Replay:
    """Stands for a recorded call where there is no GPU."""

    def __init__(self, function):
        self.function = function

    def replayed(self, inputs):
        return self.function(*inputs)


@pytest.fixture
def recordings(monkeypatch):
    """Return the shapes of the calls that are recorded, without a GPU."""
    shapes = []

    def record(function, inputs):
        shapes.append(tuple(inputs[0].shape))
        return Replay(function)

    monkeypatch.setattr(cuda_graphs, "recorded_call", record)
    monkeypatch.setattr(cuda_graphs, "least_seconds", lambda *_: next(TIMES))
    return shapes


def test_a_call_is_recorded_once_for_each_name_and_shape(recordings):
    graphs = CudaGraphs()
    for size in (2, 3, 2):
        for name in ("one", "two"):
            result, total = graphs.call(name, squares, torch.full((size,), 3.0))
            assert result.tolist() == [9.0] * size
            assert total == 3.0 * size
    assert recordings == [(2,), (2,), (3,), (3,)]


def test_few_graphs_are_kept_and_other_calls_are_plain(recordings):
    graphs = CudaGraphs()
    for size in range(1, MAX_GRAPHS + 4):
        assert graphs.call("name", squares, torch.ones(size))[1] == size
    assert len(recordings) == MAX_GRAPHS


def test_a_call_that_cannot_be_recorded_is_plain_and_tried_once(monkeypatch):
    tried = []
    monkeypatch.setattr(cuda_graphs, "recorded_call", lambda *_: tried.append(1))
    graphs = CudaGraphs()
    for _ in range(3):
        assert graphs.call("name", squares, torch.ones(4))[1] == 4
    assert tried == [1]


def test_a_call_that_is_about_as_fast_when_replayed_is_plain(recordings, monkeypatch):
    times = iter([1.0, 0.95])
    monkeypatch.setattr(cuda_graphs, "least_seconds", lambda *_: next(times))
    graphs = CudaGraphs()
    for _ in range(2):
        assert graphs.call("name", squares, torch.ones(4))[1] == 4
    assert recordings == [(4,)]
    assert not any(graphs._calls.values())


@pytest.mark.parametrize("fitting", [0, 1])
def test_a_graph_for_which_memory_runs_out_is_dropped(recordings, monkeypatch, fitting):
    """While the plain call or the replayed one is timed."""
    times = iter([1.0] * fitting)

    def least_seconds(*_):
        for seconds in times:
            return seconds
        raise torch.OutOfMemoryError("no room")

    monkeypatch.setattr(cuda_graphs, "least_seconds", least_seconds)
    graphs = CudaGraphs()
    for _ in range(2):
        assert graphs.call("name", squares, torch.ones(4))[1] == 4
    assert recordings == [(4,)]
    assert not any(graphs._calls.values())


def test_other_errors_of_a_timed_call_are_raised(recordings, monkeypatch):
    def fail(*_):
        raise RuntimeError("an illegal memory access")

    monkeypatch.setattr(cuda_graphs, "least_seconds", fail)
    with pytest.raises(RuntimeError, match="illegal"):
        CudaGraphs().call("name", squares, torch.ones(4))
