# SPDX-License-Identifier: MIT
import copy
import math

import pytest
import torch
from host_waits import META, WaitsRefused
from scans import SMALL
from tiny_network import CLASS_WEIGHTS, TinyNetwork, batch, learner
from torch import Tensor, nn

from salsanext_cli import label_space
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.training.learner import (
    Learner,
    build_optimiser,
    fastest_precision,
    learning_rate,
    seed_dropout,
)
from salsanext_cli.training.losses import SegmentationLoss
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.training.running_average import RunningAverage

CPU = torch.device("cpu")


def test_a_step_is_a_function_of_its_number_and_leaves_the_global_generator_alone() -> None:
    states = []
    for seed in (1, 2):
        torch.manual_seed(seed)
        before = torch.get_rng_state()
        learning = learner(dropout=0.5)
        learning.step(*batch(), 4, 10)
        assert torch.equal(torch.get_rng_state(), before)
        states.append(learning.module.state_dict())
    for one, other in zip(states[0].values(), states[1].values(), strict=True):
        assert torch.equal(one, other)


def test_dropout_has_the_numbers_of_the_global_seed() -> None:
    with torch.random.fork_rng([]):
        torch.manual_seed(2**32 - 1)
        expected = torch.rand(4)
        seed_dropout(2**32 - 1, CPU)
        assert torch.equal(torch.rand(4), expected)


def fused(learning: Learner) -> Learner:
    """Return a learner with the optimiser that it has on a GPU."""
    learning.optimiser = build_optimiser(learning.module, learning.recipe, fused=True)
    return learning


@pytest.mark.parametrize("clip", [0.0, 1.0])
@pytest.mark.parametrize("spoilt", ["image", "gradient"])
@pytest.mark.parametrize("optimiser", ["sgd", "adamw"])
@pytest.mark.parametrize("prepare", [lambda learning: learning, fused])
def test_a_loss_or_gradient_that_is_not_finite_changes_no_weight(clip, spoilt, optimiser, prepare):
    """Nor the state of the optimiser: the next step is as if it were the first."""
    changes = {"clip_gradient": clip, "average": 0.5, "optimiser": optimiser}
    learning, other = prepare(learner(**changes)), prepare(learner(**changes))
    before = [copy.deepcopy(m.state_dict()) for m in (learning.module, learning.average)]
    images, truth = batch()
    if spoilt == "image":
        images[0, 0, 3, 3] = math.nan
    else:
        weight = learning.module.features.weight
        hook = weight.register_hook(lambda gradient: gradient * math.inf)
    assert math.isnan(learning.step(images, truth, 0, 10))
    for module, state in zip((learning.module, learning.average), before, strict=True):
        for name, parameter in module.named_parameters():
            assert torch.equal(parameter, state[name])
    if spoilt == "gradient":
        hook.remove()
    assert torch.equal(learning.step(*batch(), 1, 10), other.step(*batch(), 1, 10))
    for one, two in zip(learning.module.parameters(), other.module.parameters(), strict=True):
        assert torch.equal(one, two)


@pytest.mark.parametrize(
    "changes", [{}, {"momentum": 0.0}, {"optimiser": "adamw", "clip_gradient": 1.0, "average": 0.9}]
)
def test_a_fused_optimiser_learns_the_same(changes: dict[str, object]) -> None:
    """Without batch norm, before which the gradient of a bias is rounding alone."""
    plain, together = learner(**changes), fused(learner(**changes))
    for learning in (plain, together):
        learning.module.norm = nn.Identity()  # type: ignore[assignment]
        if learning.average is not learning.module:
            learning.average.norm = nn.Identity()  # type: ignore[assignment]
    for step in range(3):
        for learning in (plain, together):
            learning.step(*batch(step), step, 10)
    for one, other in ((plain.module, together.module), (plain.average, together.average)):
        for name, tensor in one.state_dict().items():
            torch.testing.assert_close(other.state_dict()[name], tensor, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("is_there", [False, True])
@pytest.mark.parametrize(
    "changes",
    [
        {},
        {"accumulate": 2, "lovasz": 0.0},
        {"optimiser": "adamw", "clip_gradient": 1.0, "average": 0.9},
    ],
)
def test_the_host_waits_for_nothing_in_a_step(changes: dict[str, object], is_there: bool) -> None:
    """With a batch in pinned memory, and with one on the device."""
    recipe = Recipe(batch=2).with_changes(**changes)
    learning = Learner(TinyNetwork(3), recipe, CLASS_WEIGHTS, CPU, sets=((1, 2),))
    learning.device = META
    # A fused optimiser does not support this device, so its kernel is replaced.
    learning.module = learning.forward = learning.module.to(META)
    learning.average = learning.average.to(META)
    if recipe.average:
        learning.running_average = RunningAverage(learning.average, learning.module, recipe.average)
    learning.loss.to(META)
    learning.optimiser = build_optimiser(learning.module, recipe)
    learning.optimiser.defaults["fused"] = True
    learning.optimiser.step = lambda: None  # type: ignore[method-assign]
    images, truth = batch()
    truth[0, :4] = 3  # the set
    if is_there:
        images = images.to(META)
        truth = truth.to(META)
    with WaitsRefused(pinned=[images, truth]):
        assert learning.step(images, truth, 0, 10).device == META


def test_clipping_bounds_the_gradient() -> None:
    learning = learner(clip_gradient=1e-3)
    learning.step(*batch(), 0, 10)
    norms = [p.grad.norm() for p in learning.module.parameters() if p.grad is not None]
    assert float(torch.stack(norms).norm()) == pytest.approx(1e-3, rel=1e-3)


# Parts of a batch


def without_norm(**changes: object) -> Learner:
    """Return a learner of a network without statistics over images."""
    learning = learner(dropout=0.0, batch=5, learning_rate=1e-9, **changes)
    learning.module.norm = nn.Identity()  # type: ignore[assignment]
    return learning


def five() -> tuple[Tensor, Tensor]:
    """Return images with different numbers and classes of scored pixels."""
    images = torch.randn(5, 5, 16, 32, generator=torch.Generator().manual_seed(3))
    truth = (images[:, 0] > torch.linspace(-1, 1, 5)[:, None, None]).byte() + 1
    truth[1, :, 5:] = 0
    return images, truth


@pytest.mark.parametrize("parts", [2, 3, 5, 9])
def test_a_batch_in_parts_has_the_gradient_of_the_whole(parts: int) -> None:
    whole, accumulated = without_norm(lovasz=0.0), without_norm(lovasz=0.0, accumulate=parts)
    loss = whole.step(*five(), 0, 10).item()
    assert accumulated.step(*five(), 0, 10).item() == pytest.approx(loss, rel=1e-6)
    for one, other in zip(whole.module.parameters(), accumulated.module.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-5, atol=1e-7)


def test_lovasz_is_the_mean_of_the_parts() -> None:
    """The step beside the same loss put together by hand from the losses of the parts."""
    images, truth = five()
    learning = without_norm(accumulate=2)
    entropy, both = (SegmentationLoss(CLASS_WEIGHTS, lovasz) for lovasz in (0.0, 1.0))
    with torch.no_grad():
        logits = learning.module(images)
    parts = [slice(0, 3), slice(3, 5)]
    lovasz = [both(logits[p], truth[p]) - entropy(logits[p], truth[p]) for p in parts]
    expected = float(entropy(logits, truth) + (lovasz[0] + lovasz[1]) / 2)
    assert learning.step(images, truth, 0, 10).item() == pytest.approx(expected, rel=1e-6)


# Shorter types


class ThreeLayers(TinyNetwork):
    """One more layer, between that of the range image and that of the logits."""

    def __init__(self) -> None:
        super().__init__(3, dropout=0.0)
        self.norm = nn.Sequential(nn.Conv2d(8, 8, 1), self.norm)


def stepped(precision: str) -> tuple[Learner, float, list[torch.dtype]]:
    """Return a learner after a step, the loss, and the type of the output of each layer."""
    recipe = Recipe(batch=2, warm_up=0.0, precision=precision, dropout=0.0, clip_gradient=1.0)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = ThreeLayers()
    learning, seen = Learner(module, recipe, CLASS_WEIGHTS, CPU), []
    for layer in (module.features, module.norm[0], module.logits):
        layer.register_forward_hook(lambda layer, given, made: seen.append(made.dtype))
    return learning, learning.step(*batch(), 0, 1).item(), seen


@pytest.mark.parametrize("precision", ["bfloat16", "float16"])
def test_shorter_types_compute_shorter_and_learn_the_same(precision: str) -> None:
    """The losses may differ by their rounding only, 2⁻⁹ and 2⁻¹²."""
    exact, loss, dtypes = stepped("float32")
    assert dtypes == [torch.float32] * 3
    shorter, shorter_loss, dtypes = stepped(precision)
    assert dtypes == [torch.float32, getattr(torch, precision), torch.float32]
    filters = shorter.module.features.weight
    assert filters.is_contiguous(memory_format=torch.channels_last)
    assert exact.module.features.weight.is_contiguous()
    assert shorter_loss == pytest.approx(loss, rel=0.02)
    assert shorter_loss != loss
    assert shorter.scaler.is_enabled() == (precision == "float16")
    weights = shorter.module.state_dict()
    for name, expected in exact.module.state_dict().items():
        assert weights[name].dtype == expected.dtype
        torch.testing.assert_close(weights[name], expected, rtol=0.05, atol=1e-3)


def test_steps_with_overflow_in_float16_are_skipped_and_the_scale_falls() -> None:
    learning, _, _ = stepped("float16")
    before = {name: tensor.clone() for name, tensor in learning.module.named_parameters()}
    learning.scaler.update(2.0**40)
    learning.step(*batch(1), 1, 1)
    for name, parameter in learning.module.named_parameters():
        assert torch.equal(parameter, before[name])
    assert learning.scaler.get_scale() < 2.0**40


# Optimiser, learning rate and validation


def test_sgd_and_its_decay_are_the_papers():
    defaults = build_optimiser(nn.Linear(1, 1), Recipe()).defaults
    papers = {"lr": 0.01, "momentum": 0.9, "weight_decay": 1e-4, "dampening": 0, "nesterov": False}
    assert defaults.items() >= papers.items()
    recipe = Recipe(learning_rate=0.01, epochs=5)
    rates = [learning_rate(recipe, step, 10) for step in range(50)]
    assert rates[0] == pytest.approx(0.001)
    assert rates[:10] == sorted(rates[:10])
    assert rates[9] == pytest.approx(0.01)
    assert rates[10:20] == pytest.approx([0.01] * 10)
    assert rates[20:30] == pytest.approx([0.0099] * 10)
    assert rates[49] == pytest.approx(0.01 * 0.99**3)


def test_one_cycle_is_torchs() -> None:
    epochs, steps = 4, 25
    warm_up = 0.3 * epochs - 1 / steps
    recipe = Recipe(epochs=epochs, schedule="one-cycle", learning_rate=0.003, warm_up=warm_up)
    optimiser = torch.optim.SGD([nn.Parameter(torch.zeros(1))], lr=1.0, momentum=0.9)
    shape = {"pct_start": 0.3, "cycle_momentum": False}
    cycle = torch.optim.lr_scheduler.OneCycleLR(optimiser, 0.003, epochs * steps, **shape)
    for step in range(epochs * steps):
        assert learning_rate(recipe, step, steps) == pytest.approx(cycle.get_last_lr()[0])
        optimiser.step()
        if step + 1 < epochs * steps:
            cycle.step()


@pytest.mark.parametrize(
    ("device", "capability", "precision"),
    [("cpu", None, "float32"), ("cuda", (9, 0), "float16"), ("cuda", (6, 1), "float32")],
)
def test_a_gpu_validates_in_the_number_type_of_predict(device, capability, precision, monkeypatch):
    """Whatever the number type of the training, which is bfloat16 here."""
    monkeypatch.setattr("salsanext_cli.core.engines.torch_backend.set_up_cuda", lambda: None)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    learning = learner(precision="bfloat16", average=0.9)
    learning.device = torch.device(device)
    network = learning.network(WeightsCard({}, label_space(), SMALL))
    assert network.module is learning.average
    assert (network.device, network.backend.precision) == (device, precision)


@pytest.mark.parametrize(
    ("multiplies", "capability", "chosen"),
    [
        (True, (9, 0), ("bfloat16", "bfloat16")),
        (False, (8, 0), ("float32", "bfloat16")),
        (False, (7, 5), ("float32", "float16")),
    ],
)
def test_auto_is_the_fastest_type_of_the_device(multiplies, capability, chosen, monkeypatch):
    monkeypatch.setattr("salsanext_cli.training.learner.bfloat16_instructions", lambda: multiplies)
    monkeypatch.setattr(torch.cuda, "get_device_capability", lambda device: capability)
    devices = (torch.device("cpu"), torch.device("cuda", 0))
    assert tuple(map(fastest_precision, devices)) == chosen
