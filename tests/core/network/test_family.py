# SPDX-License-Identifier: MIT
"""SalsaNext as published, and the networks of the plug-in `examples/paper_networks`."""

import json
import tomllib
from dataclasses import replace
from functools import cache
from pathlib import Path
from pkgutil import resolve_name

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from paper_networks import ladder
from paper_networks.figures import agrees, costs, paper_figures
from paper_networks.ladder import Ladder, ReplicatingConvTranspose2d
from paper_networks.rangenet53 import RangeNet53
from scans import SMALL, lively, make_scan, refused

from salsanext_cli import label_space, project, sample
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.engines.torch_backend import TorchBackend
from salsanext_cli.core.errors import UsageError, WeightsError
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.dropout import dropouts, random_masks, sampling
from salsanext_cli.core.network.registry import build, plugged_networks
from salsanext_cli.core.network.salsanext import SalsaNext
from salsanext_cli.core.optional_packages import extra_command
from salsanext_cli.io.weights.published import our_name
from salsanext_cli.io.weights.weights import read_weights, save_weights
from salsanext_cli.training.learner import Learner
from salsanext_cli.training.recipe import Recipe

PLUG_IN = Path(__file__).parents[3] / "examples/paper_networks"
PROJECT = tomllib.loads((PLUG_IN / "pyproject.toml").read_text("utf-8"))["project"]
POINTS = PROJECT["entry-points"]["salsanext.networks"]
NETWORKS = {"salsanext": SalsaNext, **{name: resolve_name(point) for name, point in POINTS.items()}}
TWINS = {"salsanet-shuffle", "salsanext-v1-pooling"}
"""Steps of an ablation that change only the loss."""
FAST = {"salsanet", "salsanext"}
EACH = pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=() if name in FAST else pytest.mark.slow)
        for name in sorted(NETWORKS.keys() - TWINS)
    ],
)
OFF = {"salsanext", "salsanet-shuffle", "salsanet-pooling"}
"""Networks whose printed figures differ from those of the papers' text and code."""
COUNTS = {
    "salsanext": (6_711_572, 62_297_997_312),
    "salsanext-v1": (23_262_548, 33_042_726_912),
    "rangenet53": (50_377_364, 359_707_705_344),
    "salsanet": (6_582_612, 25_593_643_008),
    "salsanet-context": (6_649_428, 34_263_269_376),
    "salsanet-dropout": (6_649_428, 34_263_269_376),
    "salsanet-pooling": (5_865_588, 33_055_309_824),
    "salsanet-dilated": (9_246_036, 73_052_192_768),
    "salsanet-shuffle": (6_711_572, 62_297_997_312),
    "salsanext-v1-layers": (26_386_516, 32_002_539_520),
    "salsanext-v1-context": (26_406_196, 34_552_676_352),
    "salsanext-v1-dropout": (26_406_196, 34_552_676_352),
    "salsanext-v1-pooling": (23_262_548, 33_042_726_912),
}
"""Parameters and multiply-accumulates of 64×2048, by arithmetic from the papers' text."""
SPACE = label_space()


@pytest.fixture
def plugged(tmp_path, monkeypatch):
    """Install the plug-in in this process."""
    info = tmp_path / "site/paper_networks-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Metadata-Version: 2.1\nName: {PROJECT['name']}\nVersion: 1.0")
    points = [f"{name} = {point}" for name, point in POINTS.items()]
    (info / "entry_points.txt").write_text("\n".join(["[salsanext.networks]", *points]))
    monkeypatch.syspath_prepend(info.parent)
    plugged_networks.cache_clear()
    yield
    plugged_networks.cache_clear()


def network(name):
    """Return a network of random weights that has seen training."""
    card = WeightsCard({"name": name}, SPACE, SMALL)
    size = (SMALL.height, SMALL.width)
    return Network(TorchBackend(lambda: trained(name), card, size), SMALL)


@cache
def trained(name):
    # A module of the inference mode could not be given to another module later.
    with torch.random.fork_rng([]), torch.inference_mode(False):
        torch.manual_seed(0)
        module = lively(NETWORKS[name](class_count=SPACE.class_count, dropout=0.2))
    if name == "rangenet53":
        # Dozens of residual blocks would make logits of 100 000, unlike training.
        for key, values in module.state_dict().items():
            if key.endswith("wide.1.weight"):
                values.fill_(0.1)
    return module


def noise(*shape, seed=0):
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed))


@EACH
def test_costs_are_those_of_arithmetic(name):
    with torch.device("meta"):
        assert costs(NETWORKS[name]()) == COUNTS[name]


def test_parameters_are_those_of_the_papers_to_the_digit():
    assert NETWORKS.keys() == COUNTS.keys() == paper_figures().keys()
    for name, figures in paper_figures().items():
        count = COUNTS[name][0]
        assert agrees(count, figures.parameters) == (name not in OFF)
        assert count / 1e6 == pytest.approx(float(figures.parameters), rel=0.01)


def extent(module, axis):
    """Return the longest span of the image that a pixel of a middle cell has gradients for."""
    for values in module.parameters():
        # All positive, so that nothing cancels.
        torch.nn.init.constant_(values, 1 / values[0].numel())
    # Two lines at the coarsest level: the taps of a 2×2 window, dilated, lie both outside of one.
    size = [max(4, 2 * step) for step in module.stride]
    size[axis] = 1024
    image = torch.ones(1, 5, *size, dtype=torch.float64, requires_grad=True)
    lines = module.double().eval()(image)[0, 0].movedim(axis, 0)[:, 2]
    spans = []
    for line in range(512, 512 + module.stride[axis]):
        (gradient,) = torch.autograd.grad(lines[line], image, retain_graph=True)
        covered = gradient[0].sum(dim=(0, 2 - axis)).nonzero().flatten()
        spans.append(int(covered[-1] - covered[0]) + 1)
    return max(spans)


def narrow(name):
    """Return a network of few channels, whose receptive field is the same."""
    if name == "salsanext":
        return SalsaNext(1, 0.0, context_width=4, widths=5 * (4,), decoder_widths=4 * (4,))
    design = NETWORKS[name].keywords["design"]
    widths, ups = (tuple(4 for _ in many) for many in (design.widths, design.decoder_widths))
    few = replace(design, context_width=4, widths=widths, decoder_widths=ups)
    return Ladder(1, 0.0, design=few)


@EACH
def test_receptive_fields_are_where_gradients_are_not_zero(name):
    if name == "rangenet53":
        sides = [extent(RangeNet53(1, width=2), axis) for axis in (0, 1)]
    else:
        sides = 2 * [extent(narrow(name), axis=0)]
    assert paper_figures()[name].receptive_field == sides


@EACH
@torch.inference_mode()
def test_odd_sizes(name):
    logits = trained(name)(noise(1, 5, 9, 37))
    assert logits.shape == (1, 20, 9, 37)
    assert torch.isfinite(logits).all()
    assert logits.std() > 0


@EACH
@torch.inference_mode()
def test_the_trunk_ends_at_the_first_dropout(name):
    module, image = trained(name), noise(1, 5, 32, 32)
    features = module.trunk(image)
    assert torch.equal(module.rest(*features), module(image))
    with sampling(random_masks([torch.Generator().manual_seed(1)])):
        for sampled, certain in zip(module.trunk(image), features, strict=True):
            assert torch.equal(sampled, certain)
        whole = module(image)
    with sampling(random_masks([torch.Generator().manual_seed(1)])):
        assert torch.equal(module.rest(*features), whole)
    assert not torch.equal(module.rest(*features), whole)


@EACH
def test_a_step_of_training_reaches_every_parameter(name):
    module = NETWORKS[name](class_count=20, dropout=0.0)
    learner = Learner(module, Recipe(optimiser="sgd"), torch.ones(20), torch.device("cpu"))
    # Below 17 rows the coarsest level is one, which a dilated 2×2 window steps over.
    truth = torch.from_numpy(np.random.default_rng(0).integers(0, 20, (2, 20, 40), np.uint8))
    loss = learner.step(noise(2, 5, 20, 40), truth, 0, 1)
    assert np.isfinite(loss.item())
    lost = [key for key, p in module.named_parameters() if p.grad is None or not p.grad.any()]
    assert lost == []


@EACH
def test_sampled_dropout(name):
    image = project(make_scan(), replace(SMALL, width=32))
    first, other = (sample(network(name), image, samples=2, seed=seed) for seed in (0, 1))
    assert not np.array_equal(first.variance, other.variance)
    assert np.isfinite(first.variance).all()
    assert 0 <= first.uncertainty.epistemic.min() < first.uncertainty.epistemic.max()


@pytest.mark.parametrize(
    ("name", "momentum", "rate"), [("rangenet53", 0.01, 0.01), ("salsanet", 0.1, 0.2)]
)
def test_momentum_of_batch_norm_and_default_rate_are_the_authors(name, momentum, rate):
    module = NETWORKS[name]()
    norms = [m for m in module.modules() if isinstance(m, torch.nn.BatchNorm2d)]
    assert {norm.momentum for norm in norms} == {momentum}
    assert {layer.rate for layer in dropouts(module)} == {rate}


@pytest.mark.real
def test_names_and_shapes_are_those_of_the_published_checkpoint(golden):
    rows = (golden / "salsanext_state_dict.tsv").read_text().splitlines()
    shapes = dict(row.split("\t") for row in rows)
    published = {our_name(name): tuple(json.loads(shape)) for name, shape in shapes.items()}
    ours = {name: tuple(tensor.shape) for name, tensor in SalsaNext().state_dict().items()}
    assert published == ours


def test_dropout_rates_and_their_places():
    """Blocks 2 to 5 and up blocks 1 to 3 drop; the first and the last do not."""
    rates = {
        name: module.rate
        for name, module in SalsaNext(dropout=0.3).named_modules()
        if hasattr(module, "rate")
    }
    off = {name.split(".")[0] for name, rate in rates.items() if rate == 0}
    on = {name.split(".")[0] for name, rate in rates.items() if rate == 0.3}
    assert off == {"down1", "up4"}
    assert on == {"down2", "down3", "down4", "bottom", "up1", "up2", "up3"}
    assert len(rates) == 5 + 3 * 4


@pytest.mark.parametrize("training", [False, True])
def test_the_first_version_repeats_the_last_row_and_column(training):
    """The published up block: convolution, repetition, LeakyReLU, batch norm, in this order."""
    block = ladder.UpBlock(ladder.V1_LAYERS, 6, 4, 4, 0.0)
    unit = lively(block.raising).train(training)
    x = torch.randn(2, 6, 5, 7)
    convolution, _, norm = unit
    short = F.conv_transpose2d(x, convolution.weight, convolution.bias, stride=2, padding=1)
    assert short.shape == (2, 4, 9, 13)
    edges = np.pad(short.detach().numpy(), ((0, 0), (0, 0), (0, 1), (0, 1)), mode="edge")
    bent = np.where(edges > 0, edges, 0.01 * edges)
    mean, variance = norm.running_mean.numpy(), norm.running_var.numpy()
    if training:
        mean, variance = bent.mean(axis=(0, 2, 3)), bent.var(axis=(0, 2, 3))
    scale, shift = (p.detach().numpy()[:, None, None] for p in (norm.weight, norm.bias))
    mean, variance = mean[:, None, None].copy(), variance[:, None, None].copy()
    expected = (bent - mean) / np.sqrt(variance + norm.eps) * scale + shift
    np.testing.assert_allclose(unit(x).detach().numpy(), expected, rtol=1e-4, atol=1e-5)


def test_every_network_of_the_first_version_repeats_and_no_other_does():
    with torch.device("meta"):
        repeating = {
            name
            for name, make in NETWORKS.items()
            if any(isinstance(module, ReplicatingConvTranspose2d) for module in make().modules())
        }
    assert repeating == {name for name in NETWORKS if name.startswith("salsanext-v1")}


@pytest.mark.usefixtures("plugged")
def test_the_plug_in_builds_what_older_weights_name(tmp_path):
    assert set(plugged_networks()) == set(POINTS)
    older = {"name": "salsanet", "class_count": 20, "dropout": 0.2}
    path = tmp_path / "w.safetensors"
    save_weights(path, trained("salsanet"), WeightsCard(older, SPACE, SMALL))
    assert isinstance(read_weights(path)[0], Ladder)
    assert isinstance(build({"name": "rangenet53"}), RangeNet53)


def test_without_the_plug_in_a_hint_names_it(tmp_path):
    older = {"name": "rangenet53", "class_count": 20, "dropout": 0.2}
    path = tmp_path / "w.safetensors"
    save_weights(path, torch.nn.BatchNorm1d(1), WeightsCard(older, SPACE, SMALL))
    caught = refused(WeightsError, path, read_weights, path)
    assert extra_command("paper") in caught.value.hint
    with pytest.raises(UsageError) as caught:
        build({"name": "resnet"})
    assert caught.value.hint == ""
