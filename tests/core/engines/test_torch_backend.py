# SPDX-License-Identifier: MIT
"""What the backends share: reduction of a softmax, float32 ends, settings of CUDA."""

import warnings
from concurrent.futures import ThreadPoolExecutor
from typing import cast

import numpy as np
import pytest
import torch
from scans import SMALL
from tiny_network import TinyNetwork

from salsanext_cli import label_space
from salsanext_cli.core.engines import torch_backend
from salsanext_cli.core.engines.cuda_graphs import CudaGraphs
from salsanext_cli.core.engines.device_copies import HostCopies
from salsanext_cli.core.engines.memory import out_of_memory
from salsanext_cli.core.engines.torch_backend import (
    Float32Convolution,
    TorchBackend,
    keep_ends_in_float32,
    set_up_cuda,
)
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.io.weights.loading import network_of_module


def test_ends_in_float32_have_the_weights_of_the_layers_that_they_replace():
    module = TinyNetwork().eval()
    parameters = dict(module.named_parameters())
    state = torch.random.get_rng_state()
    keep_ends_in_float32(module, torch.bfloat16)
    assert torch.equal(torch.random.get_rng_state(), state)
    assert all(new is parameters[name] for name, new in module.named_parameters())
    assert [*module.state_dict()] == [*TinyNetwork().state_dict()]
    ends = {name for name, each in module.named_modules() if isinstance(each, Float32Convolution)}
    assert ends == {"features", "logits"}
    assert not any(layer.training for layer in module.modules())
    image = torch.ones(1, 5, 4, 4)
    assert module.features(image).dtype == torch.bfloat16
    assert module.logits(torch.ones(1, 8, 4, 4, dtype=torch.bfloat16)).dtype == torch.float32


def test_a_network_in_training_is_computed_in_its_number_type():
    """Its ends are in float32 already, with features that autocast makes short."""
    module = TinyNetwork().eval()
    expected = module(torch.ones(1, 5, 16, 128))
    keep_ends_in_float32(module)
    card = WeightsCard({}, label_space(), SMALL)
    network = network_of_module(module, card, "cpu", "bfloat16")
    (logits,) = network.backend.logits([np.ones((1, 5, 16, 128), np.float32)])
    assert logits.dtype == np.float32
    assert (logits != expected[0].detach().numpy()).any()
    np.testing.assert_allclose(logits, expected[0].detach().numpy(), atol=0.05)
    assert module.features.output == torch.float32


def test_settings_of_cuda_are_those_of_the_process_whatever_its_threads_do():
    """Contexts that overlapped in two threads once left the settings of the first behind."""
    card = WeightsCard({}, label_space(), SMALL)
    cudnn = torch.backends.cudnn

    def make(_):
        return TorchBackend(TinyNetwork, card, (16, 128), "cuda")

    with cudnn.flags(enabled=True, benchmark=True, deterministic=False, allow_tf32=True):
        set_up_cuda.cache_clear()
        try:
            with ThreadPoolExecutor(2) as pool:
                assert len([*pool.map(make, range(4))]) == 4
            assert (cudnn.benchmark, cudnn.deterministic, cudnn.allow_tf32) == (False, True, False)
            assert not torch.backends.cuda.matmul.allow_tf32
            warnings.warn(f"{torch_backend.NEWER_SETTINGS} behavior.", UserWarning, stacklevel=1)
        finally:
            set_up_cuda.cache_clear()


@pytest.mark.parametrize(
    "text",
    [
        "CUDA out of memory. Tried to allocate 2.00 GiB",
        "CUDA error: CUBLAS_STATUS_ALLOC_FAILED when calling `cublasCreate(handle)`",
        "CUDA error: CUBLAS_STATUS_NOT_INITIALIZED when calling `cublasCreate(handle)`",
        "cuDNN error: CUDNN_STATUS_ALLOC_FAILED",
        "CUDA error: out of memory",
    ],
)
def test_allocations_that_fail_on_a_gpu_are_memory_that_runs_out(text):
    assert out_of_memory(RuntimeError(text))
    assert not out_of_memory(RuntimeError("CUDA error: an illegal memory access"))


def test_batches_of_few_pixels_are_recorded_on_a_gpu_unless_their_network_trains(monkeypatch):
    module = TinyNetwork().eval()
    card = WeightsCard({}, label_space(), SMALL)
    backend = TorchBackend(lambda: module, card, (16, 128))
    in_training = cast(TorchBackend, network_of_module(module, card, "cpu").backend)
    images = [torch.ones(count, 5, 16, 128) for count in (1, 4, 5)]
    expected = [backend.softmax(batch, 2.0) for batch in images]
    recorded = []

    def call(_, name, function, *inputs):
        recorded.append((name, len(inputs[0])))
        return function(*inputs)

    monkeypatch.setattr(torch_backend, "MAX_GRAPH_PIXELS", 4 * 16 * 128)
    monkeypatch.setattr(TorchBackend, "_on_gpu", True)
    monkeypatch.setattr(CudaGraphs, "call", call)
    for batch, softmax in zip(images, expected, strict=True):
        torch.testing.assert_close(backend.softmax(batch, 2.0), softmax)
        torch.testing.assert_close(in_training.softmax(batch, 2.0), softmax)
    assert recorded == [("logits", 1), ("logits", 4)]


def test_what_leaves_the_library_is_not_page_locked(monkeypatch):
    """Arrays of the tests stand for page-locked memory."""
    staging = [np.arange(6.0), np.ones((2, 3), np.uint8)]
    monkeypatch.setattr(TorchBackend, "_on_gpu", True)
    monkeypatch.setattr(HostCopies, "arrays", lambda _: staging)
    backend = TorchBackend(TinyNetwork, WeightsCard({}, label_space(), SMALL), (16, 128))
    for array, source in zip(backend.to_host([torch.ones(1)]), staging, strict=True):
        np.testing.assert_array_equal(array, source)
        assert not np.shares_memory(array, source)
