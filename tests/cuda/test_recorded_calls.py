# SPDX-License-Identifier: MIT
# ruff: noqa: F811
"""Calls that a GPU replays as CUDA graphs compute what plain calls do."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from devices import CUDA
from scans import SMALL, make_scan
from shallow import shallow, weights  # noqa: F401

from salsanext_cli import Network, RangeImage, load_network, project
from salsanext_cli.core.engines import torch_backend
from salsanext_cli.core.engines.cuda_graphs import CudaGraphs, recorded_call
from salsanext_cli.core.uncertainty.aleatoric import aleatoric, noise_variance
from salsanext_cli.core.uncertainty.monte_carlo import sample

pytestmark = CUDA


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
    x = torch.ones(3, device="cuda")

    def scaled(values: torch.Tensor) -> tuple[torch.Tensor]:
        return (values * values.sum().item(),)

    assert recorded_call(scaled, (x,)) is None
    assert CudaGraphs().call("scaled", scaled, x)[0].tolist() == [3.0] * 3
