# SPDX-License-Identifier: MIT
"""8-bit integers: quantised inputs, and graphs that compute what a quantised torch module does."""

import copy
from collections import Counter
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from scans import SMALL, make_scan, refused, write_weights
from shallow_network import shallow  # noqa: F401
from tiny_network import TinyNetwork
from torch import nn

from salsanext_cli import label_space, load_network, project, sample
from salsanext_cli.core.engines import graphs
from salsanext_cli.core.engines.conversion import converted
from salsanext_cli.core.engines.device import float_of_precision, multiplies_tiles_of_bytes
from salsanext_cli.core.engines.graphs import Graph, compiled_graph, quantised
from salsanext_cli.core.engines.openvino_backend import OpenVinoBackend
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.int8_inputs import Int8Input
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.io.weights.card_file import read_card
from salsanext_cli.io.weights.weights import save_with_card
from salsanext_cli.training.tuning.int8 import int8_inputs, int8_layers

pytestmark = pytest.mark.usefixtures("own_cache")

ENDS = st.floats(0, 1e6, width=32)


@given(arrays(np.float32, (2, 7), elements=ENDS))
def test_values_of_the_range_are_near_a_step_and_zero_is_exact(ends):
    lowest, highest = -ends[0], ends[1]
    layer = Int8Input.from_ranges(lowest, highest)
    steps = layer.steps.astype(np.float64)
    bounds = np.array([-layer.zero, 255 - layer.zero])
    assert bounds[0] <= 0 <= bounds[1]
    for channel, step in enumerate(steps):
        low, high = bounds * step
        assert low <= lowest[channel] * 0.999 + 0.51 * step
        assert high >= highest[channel] * 0.999 - 0.51 * step


def test_channels_of_small_values_have_small_steps():
    layer = Int8Input.from_ranges(np.zeros(3, "f4"), np.array([64, 16, 1], "f4"))
    assert (layer.zero, layer.shifts) == (0, "013")
    np.testing.assert_allclose(layer.steps, np.array([64, 32, 8]) / 255, rtol=1e-3)


SIZE = (1, 5, 32, 64)


def network() -> SalsaNext:
    """Return a small SalsaNext with random statistics of batch norm."""
    with torch.random.fork_rng():
        torch.manual_seed(3)
        module = SalsaNext(context_width=16, widths=(16, 32), decoder_widths=(16,))
        for layer in module.modules():
            if isinstance(layer, nn.BatchNorm2d):
                layer.running_mean.normal_(std=0.1)
                layer.running_var.uniform_(0.5, 1.5)
                layer.bias.data.normal_(std=0.5)
    return module.eval()


def image(seed: int = 4) -> torch.Tensor:
    return torch.randn(*SIZE, generator=torch.Generator().manual_seed(seed))


def in_bytes(module: SalsaNext, inputs: dict[str, Int8Input], *, tiles: bool) -> SalsaNext:
    """Return a module that rounds inputs and weights of its layers, in float64."""
    module = copy.deepcopy(module).double()
    for name, layer in inputs.items():
        convolution = module.get_submodule(name)
        steps = torch.from_numpy(layer.steps).double().view(1, -1, 1, 1)
        zero = layer.zero
        if tiles and convolution.padding != (0, 0):
            steps *= max(zero / 128, (255 - zero) / 127)
            zero = 128

        def rounded(_, arguments, steps=steps, zero=zero):
            return ((arguments[0] / steps).round().clamp(-zero, 255 - zero),)

        convolution.register_forward_pre_hook(rounded)
        weight = convolution.weight.data * steps
        step = weight.abs().amax(dim=(1, 2, 3), keepdim=True) / (127 if tiles else 64)
        convolution.weight.data = (weight / step).round() * step
    return module


@cache
def graph():
    """Return the graph of the network; to convert it takes half a second."""
    return converted(network(), lambda m, values: m(values), [image()])


def compiled(model, inputs: dict[str, Int8Input], *, tiles: bool = False, **options) -> Graph:
    def make():
        return quantised(model.clone(), inputs, "test", tiles=tiles)

    return Graph(compiled_graph(make, ("test", inputs, tiles), "int8", **options))


@pytest.fixture
def float32_beside_bytes(monkeypatch):
    """Let layers without ranges compute in float32 on any CPU."""
    monkeypatch.setattr(graphs, "float_of_precision", lambda precision: "float32")


WITH_AMX = pytest.mark.skipif(not multiplies_tiles_of_bytes(), reason="a CPU without AMX")


@pytest.mark.parametrize("tiles", [False, pytest.param(True, marks=WITH_AMX)])
@pytest.mark.usefixtures("float32_beside_bytes")
def test_a_graph_computes_as_a_module_with_rounded_inputs_and_weights(tiles):
    module, x = network(), image()
    inputs = int8_inputs(module, [image(seed).numpy() for seed in range(3)])
    (logits,) = compiled(graph(), inputs, tiles=tiles)(x.numpy())
    with torch.inference_mode():
        expected = in_bytes(module, inputs, tiles=tiles)(x.double()).numpy()
        exact = module(x).numpy()
    scale = np.abs(exact).mean()
    # Rounded the other way, a value at half a step changes the values after it.
    error, effect = np.abs(logits - expected), np.abs(exact - expected)
    assert error.mean() < 0.1 * effect.mean()
    assert np.median(error) < 0.01 * effect.mean()
    assert 1e-3 < np.abs(logits - exact).mean() / scale < 0.1


def test_hidden_layers_multiply_bytes_and_the_others_are_floats():
    """Those of the image and of the logits are float32, the context is in the fastest float."""
    module, x = network(), image()
    run = compiled(graph(), int8_inputs(module, [x.numpy()]))
    fastest = graphs.HINTS[float_of_precision("int8")]
    numbers = Counter()
    for op in run.compiled.get_runtime_model().get_ordered_ops():
        info = op.get_rt_info()
        if info["layerType"].astype(str) == "Convolution":
            kind, name = info["runtimePrecision"].astype(str), op.get_friendly_name()
            is_end = ".logits/" in name or ".context.0.shortcut." in name
            hidden = fastest if ".context." in name else "u8"
            assert kind == ("f32" if is_end else hidden), name
            numbers[kind] += 1
    assert numbers["u8"] == len(int8_layers(module))
    assert numbers.total() == len(int8_layers(module)) + 10


@pytest.mark.usefixtures("float32_beside_bytes")
def test_sums_of_products_do_not_saturate():
    """Without room in 16 bits, CPUs without VNNI would clip pairs of the largest products."""
    module = nn.Sequential(nn.Conv2d(64, 8, 3, bias=False)).eval()
    module[0].weight.data.fill_(1.0)
    x = torch.full((1, 64, 8, 8), 255.0)
    inputs = {"0": Int8Input(0, 1.0, "0" * 64)}
    model = converted(module, lambda m, values: m(values), [x])
    (sums,) = compiled(model, inputs)(x.numpy())
    np.testing.assert_allclose(sums, 255 * 64 * 9, rtol=1e-6)


def test_the_bits_do_not_depend_on_threads_or_streams():
    x = image()
    inputs = int8_inputs(network(), [x.numpy()])
    (expected,) = compiled(graph(), inputs)(x.numpy())
    for threads, streams in ((2, 1), (2, 2), (3, 3)):
        run = compiled(graph(), inputs, threads=threads, streams=streams)
        assert np.array_equal(run(x.numpy())[0], expected)
        outputs = run.in_parallel([[image(5).numpy()], [x.numpy()]] * 2)
        assert [np.array_equal(o[0], expected) for o in outputs] == [False, True] * 2


class OneHiddenLayer(TinyNetwork):
    """Network with one convolution between those of the image and of the logits."""

    def __init__(self) -> None:
        super().__init__()
        self.hidden = nn.Conv2d(8, 8, 3, padding=1)

    def trunk(self, image):
        return (self.norm(self.hidden(self.features(image).relu())).relu(),)


def backend(module: SegmentationNetwork, precision: str) -> OpenVinoBackend:
    card = WeightsCard({}, label_space(), SMALL, int8=int8_inputs(module, [image().numpy()]))
    size = (SMALL.height, SMALL.width)
    return OpenVinoBackend(lambda: module, card, size, precision=precision, sha256="0")


@pytest.mark.parametrize("make", [OneHiddenLayer, pytest.param(network, marks=pytest.mark.slow)])
def test_a_prediction_is_the_same_alone_and_in_a_batch_and_samples_are_float32(make):
    module = make().eval()
    int8, float32 = backend(module, "int8"), backend(module, "float32")
    images = [image(seed).repeat(1, 1, 1, 2)[:, :, :16].numpy() for seed in (1, 2)]
    together = int8.predict(images, 1.0)
    for x, pixels in zip(images, together, strict=True):
        assert np.array_equal(int8.predict([x], 1.0)[0].confidence, pixels.confidence)
        assert not np.array_equal(float32.predict([x], 1.0)[0].confidence, pixels.confidence)
    samples = [backend.sample(images[0], [1, 2]).variance for backend in (int8, float32)]
    assert np.array_equal(*samples)
    spreads = [backend.spread(images) for backend in (int8, float32)]
    assert np.array_equal(*spreads)


@pytest.fixture(scope="module")
def weights(tmp_path_factory):
    """Return weights of the architecture that is called salsanext, with ranges."""
    file = write_weights(tmp_path_factory.mktemp("int8") / "random.safetensors")
    network = load_network(file, "cpu", SMALL, engine="torch")
    inputs = network.input(project(make_scan(), SMALL).channels)
    card = replace(network.card, int8=int8_inputs(network.module, [inputs]))
    save_with_card(file, file, card)
    return file


def test_a_card_holds_the_ranges_and_int8_needs_them_and_openvino(weights, tmp_path):
    card = read_card(weights)
    again = WeightsCard.from_metadata(card.to_metadata(), "again")
    assert again.int8 == card.int8 != {}
    assert set(card.int8) == set(int8_layers(load_network(weights, "cpu").module))
    bare = tmp_path / "bare.safetensors"
    save_with_card(weights, bare, replace(read_card(weights), int8={}))
    refused(WeightsError, bare, load_network, bare, "cpu", precision="int8")
    with refused(UsageError, "precision"):
        load_network(weights, "cpu", precision="int8", engine="torch")


def test_ranges_of_another_network_are_refused():
    layers = int8_inputs(network(), [image().numpy()])
    name = "block1.shortcut.0"
    broken = replace(layers[name], shifts=layers[name].shifts[1:])
    for others in ({**layers, "block9.shortcut.0": layers[name]}, {**layers, name: broken}):
        refused(WeightsError, "test", compiled, graph(), others)


@pytest.mark.parametrize(
    "changes", [{"zero": 256}, {"zero": -1}, {"step": 0.0}, {"shifts": ""}, {"shifts": "g0"}]
)
def test_damaged_ranges_are_refused(weights, changes):
    card = read_card(weights)
    layer = Int8Input(3, 0.5, "01")
    with pytest.raises(ValueError, match="quantisation"):
        replace(layer, **changes)
    metadata = card.to_metadata()
    content = metadata["salsanext"]
    assert '"step"' in content
    broken = content.replace('"step"', '"stride"')
    refused(WeightsError, "weights", WeightsCard.from_metadata, {"salsanext": broken}, "weights")


@pytest.mark.slow
def test_samples_of_int8_weights_are_those_of_float32(weights):
    image_of_scan = project(make_scan(), SMALL)
    estimates = [
        sample(load_network(weights, "cpu", SMALL, precision=p), image_of_scan, samples=2, seed=0)
        for p in ("int8", "float32")
    ]
    assert np.array_equal(*(estimate.probabilities for estimate in estimates))
