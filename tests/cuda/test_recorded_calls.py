# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Calls that a GPU replays as CUDA graphs compute what plain calls do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import python
from devices import CUDA
from scans import SMALL, make_scan
from shallow_network import shallow, weights  # noqa: F401

from salsanext_cli import Network, RangeImage, load_network, project
from salsanext_cli.core.engines import torch_backend
from salsanext_cli.core.engines.cuda_graphs import CudaGraphs
from salsanext_cli.core.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.core.uncertainty.monte_carlo import sample

pytestmark = CUDA

NEEDS_HOST = """
import torch
from salsanext_cli.core.engines.cuda_graphs import CudaGraphs, recorded_call

def scaled(x):
    return (x * x.sum().item(),)

x = torch.ones(3, device="cuda")
stream = torch.cuda.current_stream()
assert recorded_call(scaled, (x,)) is None
assert torch.cuda.current_stream() == stream
assert CudaGraphs().call("scaled", scaled, x)[0].tolist() == [3.0] * 3
torch.cuda.empty_cache()
assert recorded_call(lambda x: (x * x,), (x,)) is not None
"""


ADDITIONS = 100  # So many that launching them takes longer than computing


def add_often(x: torch.Tensor) -> tuple[torch.Tensor]:
    for _ in range(ADDITIONS):
        x = x + 1
    return (x,)


@pytest.fixture(scope="module")
def images() -> list[RangeImage]:
    return [project(make_scan(2000, seed), SMALL) for seed in range(3)]


@pytest.fixture(params=["float32", "float16"])
def network(weights: Path, request: pytest.FixtureRequest) -> Network:
    return load_network(weights, "cuda", SMALL, request.param, "torch")


def test_predictions(
    network: Network, images: list[RangeImage], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Each result is that of its image, also after those of other images."""
    found = [network.probabilities(image) for image in images]
    assert any(network.backend._graphs._calls.values())
    monkeypatch.setattr(torch_backend, "MAX_GRAPH_PIXELS", 0)
    plain = replace(network, backend=replace(network.backend))
    for softmax, image in zip(found, images, strict=True):
        np.testing.assert_allclose(softmax, plain.probabilities(image), atol=1e-6)


def test_passes_and_density_filtering(
    network: Network, images: list[RangeImage], monkeypatch: pytest.MonkeyPatch
) -> None:
    def estimates(network: Network) -> list[np.ndarray]:
        image = images[1]
        passes = sample(network, image, samples=3, seed=1)
        return [
            passes.probabilities,
            passes.variance,
            aleatoric(network, image),
            noise_variance(network, image, 1),
        ]

    found = estimates(network)
    monkeypatch.setattr(torch_backend, "MAX_GRAPH_PIXELS", 0)
    plain = replace(network, backend=replace(network.backend))
    for values, expected in zip(found, estimates(plain), strict=True):
        np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-6)


def test_results_are_not_overwritten_by_later_calls() -> None:
    graphs = CudaGraphs()
    inputs = [torch.randn(4, 5, device="cuda") for _ in range(3)]
    results = [graphs.call("squares", lambda x: (x * x, x.sum()), x) for x in inputs]
    for x, (squares, total) in zip(inputs, results, strict=True):
        assert torch.equal(squares, x * x)
        assert torch.equal(total, x.sum())


def test_a_function_that_needs_the_host_is_not_recorded() -> None:
    """And later ones are; in a process of its own, which a failed recording may damage."""
    result = python(NEEDS_HOST)
    assert result.returncode == 0, result.stderr


@pytest.mark.skipif(torch.cuda.device_count() < 2, reason="fewer than two GPUs")
def test_each_gpu_replays_calls_of_its_own() -> None:
    for device in ("cuda:0", "cuda:1"):
        graphs = CudaGraphs()
        for value in (2.0, 3.0):
            (result,) = graphs.call("add", add_often, torch.full((4,), value).to(device))
            assert result.tolist() == [value + ADDITIONS] * 4
        assert any(graphs._calls.values())


def test_only_calls_that_are_faster_are_replayed() -> None:
    graphs = CudaGraphs()
    large = torch.randn(2048, 2048, device="cuda")
    (product,) = graphs.call("product", lambda x: (x @ x,), large)
    torch.testing.assert_close(product, large @ large)
    graphs.call("add", add_often, torch.zeros(4, device="cuda"))
    assert [call is not None for call in graphs._calls.values()] == [False, True]
