# SPDX-License-Identifier: MIT
"""Devices and engines; graphs compute what the torch modules do that they were made from."""

import hashlib
import os
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from functools import cache, partial
from pathlib import Path

import numpy as np
import openvino
import pytest
import torch
from scans import SMALL, make_scan, refused
from tiny_network import TinyNetwork
from torch import nn

from salsanext_cli import label_space, project, sample
from salsanext_cli.core.engines import openvino_runtime
from salsanext_cli.core.engines.conversion import converted
from salsanext_cli.core.engines.device import bfloat16_instructions
from salsanext_cli.core.engines.graphs import GRAPH_VERSION, Graph, compiled_graph, partly_float32
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.engines.openvino_backend import OpenVinoBackend
from salsanext_cli.core.engines.registry import choose_engine
from salsanext_cli.core.engines.torch_backend import in_precision
from salsanext_cli.core.errors import MissingDependency
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.uncertainty.aleatoric import aleatoric
from salsanext_cli.runs.annotation.scan_description import pixel_features


@pytest.mark.parametrize(
    "error",
    [
        ImportError("No module named 'openvino'"),
        AttributeError("no attribute 'Core'"),
        MissingDependency("openvino", "cannot be imported: libfoo.so", hint="install it again"),
    ],
)
def test_without_openvino_torch_computes_with_one_warning(fresh, monkeypatch, caplog, error):
    def fail():
        raise error

    monkeypatch.setattr(openvino_runtime, "openvino_core", fail)
    assert choose_engine("auto", "cpu") == choose_engine("auto", "cpu") == "torch"
    assert len(caplog.records) == 1
    caught = refused(MissingDependency, "openvino", choose_engine, "openvino", "cpu")
    assert 'engine="torch"' in caught.value.hint


ODD_SIZE = (1, 5, 19, 70)
SMALL_SIZE = (1, 5, 16, 48)
SIZE = (1, 5, 32, 96)

pytestmark = pytest.mark.usefixtures("own_cache")


WIDTHS_BY_LEVELS = {2: {"context_width": 32, "widths": (64, 256), "decoder_widths": (128,)}, 5: {}}
"""Channels of networks: with two levels, as many as those of all five have at both ends."""


def network(levels=2):
    """Return a network with random statistics of batch norm."""
    with torch.random.fork_rng():
        torch.manual_seed(3)
        module = SalsaNext(**WIDTHS_BY_LEVELS[levels])
        for layer in module.modules():
            if isinstance(layer, torch.nn.BatchNorm2d):
                layer.running_mean.normal_(std=0.1)
                layer.running_var.uniform_(0.5, 1.5)
    return module.eval()


def images(*size):
    return torch.randn(*size, generator=torch.Generator().manual_seed(4))


@cache
def graph(*size, levels=2):
    """Return the graph of a network for images of a size; to convert all levels takes a second."""
    return converted(network(levels), lambda m, image: m(image), [images(*size)])


def compiled(make, **options):
    return Graph(compiled_graph(make, "test", **options))


def convolution(x):
    """Return a function that converts a small module."""
    module = nn.Conv2d(5, 8, 3).eval()
    return partial(converted, module, lambda m, image: m(image), [x])


def test_a_graph_in_float32_refuses_inputs_that_do_not_fit():
    module, x = network(), images(*ODD_SIZE)
    (found,) = compiled(graph(*ODD_SIZE).clone)(x.numpy())
    with torch.inference_mode():
        expected = module.double()(x.double()).numpy()
    assert found.dtype == np.float32
    assert np.abs(found - expected).max() < 1e-4 * np.abs(expected).max()
    run = compiled(convolution(x))
    with pytest.raises(RuntimeError):
        run(images(1, 5, 16, 16).numpy())
    with pytest.raises(RuntimeError):
        run.in_parallel([[images(1, 5, 16, 16).numpy()]])


@pytest.mark.skipif(not bfloat16_instructions(), reason="a CPU without bfloat16")
def test_ends_stay_float32_when_the_rest_is_short():
    """By OpenVINO and by torch; a range that was rounded would be metres away."""
    module, x = network(levels=5), images(*SIZE)
    short = compiled(graph(*SIZE, levels=5).clone, precision="bfloat16")
    with torch.inference_mode():
        by_torch = in_precision(module, torch.bfloat16)(x)
        expected = module(x).numpy()
    for found in (short(x.numpy())[0], by_torch.numpy()):
        assert found.dtype == np.float32
        error = np.abs(found - expected).mean() / np.abs(expected).mean()
        assert 1e-5 < error < 0.03
    precisions = {
        str(layer.get_friendly_name()): layer.get_rt_info()["runtimePrecision"].astype(str)
        for layer in short.compiled.get_runtime_model().get_ordered_ops()
        if layer.get_rt_info()["layerType"].astype(str) == "Convolution"
    }
    assert set(precisions.values()) == {"f32", "bf16"}
    assert {p for name, p in precisions.items() if ".logits/" in name} == {"f32"}
    assert {p.dtype for p in module.parameters()} == {torch.float32}


@pytest.mark.parametrize(
    ("precision", "size", "levels"),
    [
        ("float32", SMALL_SIZE, 2),
        pytest.param("float32", SIZE, 5, marks=pytest.mark.slow),
        pytest.param("bfloat16", SIZE, 5, marks=pytest.mark.slow),
    ],
)
def test_the_bits_do_not_depend_on_threads_or_streams(precision, size, levels):
    if precision == "bfloat16" and not bfloat16_instructions():
        pytest.skip("a CPU without bfloat16")
    x, make = images(*size), graph(*size, levels=levels).clone
    others = [x.flip(axis).numpy() for axis in (2, 3)]
    (expected,) = compiled(make, precision=precision)(x.numpy())
    for threads, streams in ((2, 1), (2, 2), (3, 3)):
        run = compiled(make, precision=precision, threads=threads, streams=streams)
        assert np.array_equal(run(x.numpy())[0], expected)
        found = run.in_parallel([[image] for image in (others[0], x.numpy(), others[1])] * 3)
        equal = [np.array_equal(outputs[0], expected) for outputs in found]
        assert equal == [False, True, False] * 3


@pytest.mark.parametrize(
    ("threads", "streams"), [pytest.param(1, 1, marks=pytest.mark.slow), (2, 2)]
)
@pytest.mark.skipif(not Path("/proc/self/task").is_dir(), reason="a system without these files")
def test_computing_threads_are_not_bound_to_cores(threads, streams):
    """Workers with one thread each would all be bound to the first core."""
    if len(cores := os.sched_getaffinity(0)) < 2:
        pytest.skip("a single core")
    tasks = Path("/proc/self/task")
    before = {task.name for task in tasks.iterdir()}
    x = images(*SMALL_SIZE)
    run = compiled(graph(*SMALL_SIZE).clone, threads=threads, streams=streams)
    found = []
    with ThreadPoolExecutor(1) as pool:
        computing = pool.submit(run.in_parallel, [[x.numpy()]] * 25)
        while not computing.done():
            for task in {task.name for task in tasks.iterdir()} - before:
                with suppress(ProcessLookupError):  # it has just ended
                    found.append(os.sched_getaffinity(int(task)))
            time.sleep(0.001)
        assert len(computing.result()) == 25
    assert found
    assert all(each == cores for each in found)


def test_a_compiled_graph_is_read_from_the_cache(tmp_path, caplog):
    x = images(1, 5, 16, 32)
    make = convolution(x)
    (expected,) = compiled(make)(x.numpy())
    (blob,) = tmp_path.rglob("*.blob")

    def refuse():
        raise AssertionError("made again")

    assert np.array_equal(Graph(compiled_graph(refuse, "test"))(x.numpy())[0], expected)
    with pytest.raises(AssertionError, match="made again"):
        compiled_graph(refuse, "other")
    # Cut, changed, or of another program: made again, with a warning.
    content = blob.read_bytes()
    for damaged in (b"", content[:100], content[:-40], content[:5000] + b"\0" + content[5001:]):
        blob.write_bytes(damaged)
        assert np.array_equal(compiled(make)(x.numpy())[0], expected)
        assert np.array_equal(Graph(compiled_graph(refuse, "test"))(x.numpy())[0], expected)
    assert caplog.records


def test_nothing_is_made_again_where_memory_runs_out(monkeypatch):
    compiled(convolution(images(1, 5, 16, 32)))
    reasons = ["Exception from src/inference/src/dev/plugin.cpp:74:\ncan't alloc\n", "other build"]

    class FullCore:
        def import_model(self, *_):
            raise RuntimeError(reasons[0])

    def refuse():
        raise AssertionError("made again")

    monkeypatch.setattr("salsanext_cli.core.engines.graphs.openvino_core", FullCore)
    with pytest.raises(RuntimeError, match="can't alloc"):
        compiled_graph(refuse, "test")
    reasons.pop(0)
    with pytest.raises(AssertionError, match="made again"):
        compiled_graph(refuse, "test")


@pytest.mark.slow
def test_signals_are_handled_after_the_last_graph_is_gone():
    """OpenVINO gives a thread a stack for its handlers, and must not take it back."""
    program = """
import gc, os, signal, threading, torch
from salsanext_cli.core.engines.conversion import converted
from salsanext_cli.core.engines.graphs import Graph, compiled_graph
signal.signal(signal.SIGUSR1, lambda *_: print("handled"))
part = torch.nn.Conv2d(5, 3, 1), lambda module, image: module(image), [torch.zeros(1, 5, 8, 8)]
made = [Graph(compiled_graph(lambda: converted(*part), "test"))]
thread = threading.Thread(target=lambda: (made.clear(), gc.collect()))
thread.start()
thread.join()
os.kill(os.getpid(), signal.SIGUSR1)
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "handled\n"), done.stderr


class Fixed(TinyNetwork):
    """Network of layers that all graphs know."""

    def trunk(self, image):
        return (nn.functional.leaky_relu(self.norm(self.features(image))),)


OPERATIONS_BY = ("2026.4.1", "2.13.0")
OPERATIONS = {
    "softmax at 1.0": "f338419d8f7bb9f8",
    "logits": "724c8e4aea62e84b",
    "trunk": "f780ffe62f983d6a",
    "rest": "f2ebf5249d0e2682",
    "moments": "a2dbf455fd256f20",
    "features": "735b08ec6adff7bb",
    "salsanext": "56e5685ab6e066ab",
}
"""Digests of the operations of graphs of a small network and of a SalsaNext, by these versions."""


def operations(model) -> str:
    """Return a digest of the operations of a model, their attributes and how they are joined."""
    ops = model.get_ordered_ops()
    number = {op.get_friendly_name(): n for n, op in enumerate(ops)}
    lines = []
    for op in ops:
        inputs = [number[i.get_source_output().get_node().get_friendly_name()] for i in op.inputs()]
        attributes = {
            name: value
            for name, value in sorted(op.get_attributes().items())
            if name not in ("friendly_name", "output_names")
        }
        shapes = [str(output.get_partial_shape()) for output in op.outputs()]
        lines.append(repr((str(op.get_type_info()), attributes, inputs, shapes)))
    return hashlib.sha256("\n".join(lines).encode()).hexdigest()[:16]


def test_the_version_of_graphs_changes_with_them():
    """Graphs in the cache are used again as long as `GRAPH_VERSION` is the same."""
    made = {}

    class Recording(OpenVinoBackend):
        def _compiled(self, name, make, precision, streams=1):
            model = make()
            made[name] = operations(model)
            return super()._compiled(name, lambda: model, precision, streams)

    image = project(make_scan(), SMALL)
    card = WeightsCard({}, label_space(), SMALL)
    backend = Recording(lambda: Fixed().eval(), card, (16, 128), sha256="0")
    tiny = Network(backend, SMALL)
    tiny.probabilities(image)
    tiny.logits(image)
    sample(tiny, image, samples=2, seed=0)
    aleatoric(tiny, image)
    pixel_features(tiny, tiny.input(image.channels))
    made["salsanext"] = operations(graph(*ODD_SIZE))
    versions = (openvino.__version__.partition("-")[0], torch.__version__.partition("+")[0])
    if versions != OPERATIONS_BY:
        pytest.skip("other versions of the libraries, which are part of the key too")
    # If this differs, raise the version, and write down the new digests.
    assert (GRAPH_VERSION, made) == (2, OPERATIONS)


def test_the_layers_of_the_image_and_of_the_logits_are_marked_as_float32():
    """OpenVINO replaces the marks that it has read."""
    softmax = converted(network(), lambda m, image: m(image).softmax(dim=1), [images(1, 5, 16, 64)])
    read = partly_float32(openvino_runtime.openvino_core(), softmax)
    ops = read.get_ordered_ops()
    marked = [op for op in ops if {*op.get_rt_info().keys()} - {"fused_names_0", "precise_0"}]
    convolutions = [op for op in ops if op.get_type_name() == "Convolution"]
    of_image = [op for op in convolutions if op.input(0).get_partial_shape()[1].get_length() == 5]
    logits = [op for op in convolutions if ".logits/" in op.get_friendly_name()]
    assert len(of_image) == len(logits) == 1
    of_convolutions = [op for op in marked if op.get_type_name() == "Convolution"]
    names = {op.get_friendly_name() for op in of_convolutions}
    assert names == {op.get_friendly_name() for op in (*of_image, *logits)}
    assert "Softmax" in {op.get_type_name() for op in marked}
    assert len(convolutions) > 10
