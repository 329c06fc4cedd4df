# SPDX-License-Identifier: MIT
"""Engines, which compute the same as the networks that they stand for."""

import os
import threading

import pytest
import torch
from salsanext_cli.inference.engine import Float32Accumulation, choose_precision, engine_for
from salsanext_cli.inference.parallel_for import parallel_for, single_threaded_torch

from salsanext_cli.errors import UsageError
from salsanext_cli.network.registry import ARCHITECTURES, build

CPU = torch.device("cpu")
NAMES = sorted(ARCHITECTURES)


def network(name):
    """Return a network whose batch norms have statistics of their own."""
    with torch.random.fork_rng():
        torch.manual_seed(3)
        module = build({"name": name, "class_count": 20, "dropout": 0.2})
        for layer in module.modules():
            if isinstance(layer, torch.nn.BatchNorm2d):
                layer.running_mean.normal_(std=0.1)
                layer.running_var.uniform_(0.5, 1.5)
    return module.eval()


def images(*size):
    return torch.randn(*size, generator=torch.Generator().manual_seed(4))


@pytest.fixture(autouse=True)
def same_threads():
    """Give torch back the threads it had."""
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


@pytest.mark.parametrize("name", NAMES)
def test_every_architecture_in_float32(name):
    module = network(name)
    x = images(1, 5, 19, 70)
    with torch.inference_mode():
        found = engine_for(module, CPU, "float32")(x)
        expected = module.double()(x.double())
    assert found.dtype == torch.float32
    assert (found - expected).abs().max() < 1e-4 * expected.abs().max()


@pytest.mark.parametrize("name", ["salsanext", "rangenet53"])
def test_every_end_stays_float32_when_the_rest_is_short(name):
    module = network(name)
    x = images(1, 5, 16, 64)
    with torch.inference_mode():
        found = engine_for(module, CPU, "bfloat16")(x)
        expected = module(x)
    assert found.dtype == torch.float32
    assert (found - expected).abs().mean() < 0.03 * expected.abs().mean()
    assert {p.dtype for p in module.parameters()} == {torch.float32}


def test_long_sums_are_rounded_once():
    layer = torch.nn.Conv2d(16, 8, 3).bfloat16()
    x = images(1, 16, 9, 11).bfloat16()
    with torch.inference_mode():
        exact = torch.nn.functional.conv2d(*(t.double() for t in (x, layer.weight, layer.bias)))
        found = Float32Accumulation(layer, torch.bfloat16)(x)
    assert found.dtype == torch.bfloat16
    assert ((found - exact).abs() <= 2**-8 * exact.abs() + 1e-6).all()


@pytest.mark.parametrize("name", ["salsanext", "salsanet"])
def test_the_bits_do_not_depend_on_threads_or_on_the_rest_of_the_batch(name):
    fast = engine_for(network(name), CPU, "float32")
    x = images(3, 5, 32, 96)
    found = []
    for threads in (1, 2, 3):
        torch.set_num_threads(threads)
        with torch.inference_mode(), single_threaded_torch():
            found.append(fast(x))
            alone = fast(x[1:2])
        assert torch.equal(found[-1], found[0])
        assert torch.equal(alone[0], found[0][1])


def test_other_number_types_are_computed_as_they_are():
    module = network("salsanext").double()
    assert engine_for(module, CPU, "float32") is module


@pytest.mark.parametrize("threads", [1, 2, 4])
@pytest.mark.parametrize("count", [0, 1, 7])
def test_every_part_is_computed_once_by_one_torch_thread(threads, count):
    seen = []
    torch.set_num_threads(threads)
    with single_threaded_torch():
        parallel_for(lambda part: seen.append((part, torch.get_num_threads())), count)
    assert torch.get_num_threads() == threads
    assert sorted(seen) == [(part, 1) for part in range(count)]


def test_torch_keeps_its_threads_where_none_are_lent():
    torch.set_num_threads(3)
    parallel_for(lambda part: None, 2)
    assert torch.get_num_threads() == 3


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_in_a_part_is_raised(threads):
    def fail(part):
        if part == 3:
            raise MemoryError("no room")

    torch.set_num_threads(threads)
    with pytest.raises(MemoryError, match="no room"), single_threaded_torch():
        parallel_for(fail, 5)
    assert torch.get_num_threads() == threads


@pytest.mark.filterwarnings("ignore:This process .* is multi-threaded")
def test_threads_are_there_after_a_fork():
    torch.set_num_threads(2)
    with single_threaded_torch():
        parallel_for(lambda part: None, 2)
        child = os.fork()
        if child == 0:
            threading.Timer(20, os._exit, (1,)).start()
            parallel_for(lambda part: None, 2)
            os._exit(0)
    assert os.waitpid(child, 0)[1] == 0


@pytest.mark.parametrize("name", ["float32", "bfloat16"])
def test_precisions_of_a_cpu(name):
    assert choose_precision(name, CPU) == name


@pytest.mark.parametrize("tiles", [False, True])
def test_a_cpu_with_tiles_takes_bfloat16(monkeypatch, tiles):
    monkeypatch.setattr(torch.cpu, "_is_amx_tile_supported", lambda: tiles)
    assert choose_precision("auto", CPU) == ("bfloat16" if tiles else "float32")


@pytest.mark.parametrize("capability", [(6, 1), (7, 0), (9, 0)])
def test_a_gpu_with_tensor_cores_takes_float16(monkeypatch, capability):
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    expected = "float16" if capability >= (7, 0) else "float32"
    assert choose_precision("auto", torch.device("cuda")) == expected


@pytest.mark.parametrize("name", ["float16", "half", "", "int8"])
def test_precisions_that_are_not_there(name):
    with pytest.raises(UsageError, match="precision"):
        choose_precision(name, CPU)
