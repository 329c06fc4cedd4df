# SPDX-License-Identifier: MIT
"""What the backends share: reduction of a softmax, float32 ends, settings of CUDA."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL
from tiny_network import TinyNetwork

from salsanext_cli import label_space
from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.torch_backend import (
    Float32Convolution,
    TorchBackend,
    keep_ends_in_float32,
    set_up_cuda,
)
from salsanext_cli.core.errors import out_of_memory
from salsanext_cli.core.network.card import WeightsCard


@given(st.integers(0, 2**32 - 1), st.sampled_from([(1, 1, 1), (2, 3, 5), (20, 4, 33)]))
def test_labels_and_confidence_are_those_of_numpy_also_where_classes_are_equal(seed, shape):
    softmax = (np.random.default_rng(seed).integers(0, 4, shape) / 4).astype("f4")
    found = PixelPrediction.of(softmax)
    np.testing.assert_array_equal(found.labels, softmax.argmax(axis=0))
    np.testing.assert_array_equal(found.confidence, softmax.max(axis=0))
    assert (found.labels.dtype, found.confidence.dtype) == (np.uint8, np.float32)
    assert found.softmax is None


def test_a_softmax_that_is_kept_is_a_copy_and_nan_is_seen():
    softmax = np.full((3, 2, 4), 0.25, np.float32)
    found = PixelPrediction.of(softmax, keep=True)
    softmax[:] = 0
    assert (found.softmax == 0.25).all()
    for place in ((0, 1, 2), (2, 1, 2)):
        broken = np.zeros((3, 2, 4), np.float32)
        broken[place] = np.nan
        assert np.isnan(PixelPrediction.of(broken).confidence).sum() == 1


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
