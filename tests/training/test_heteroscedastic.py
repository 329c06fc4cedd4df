# SPDX-License-Identifier: MIT
"""The heteroscedastic term, and trainings with it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scans import SMALL, write_sequence
from scipy.stats import norm
from torch import Tensor, nn
from torch.autograd import gradcheck

from salsanext_cli.classes import label_space
from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.noise import input_variance
from salsanext_cli.geometry.projection import project
from salsanext_cli.network.blocks import Unit
from salsanext_cli.network.dropout import ChannelDropout
from salsanext_cli.network.registry import ARCHITECTURES
from salsanext_cli.network.weights import read_card
from salsanext_cli.sensors import Sensor
from salsanext_cli.stages.train import TrainResult, train
from salsanext_cli.storage.layout import find_scans
from salsanext_cli.training.dataset import Samples, batches, read_labelled
from salsanext_cli.training.heteroscedastic import (
    FLOOR,
    HeteroscedasticLoss,
    MomentNetwork,
    heteroscedastic,
    with_moments,
)
from salsanext_cli.training.losses import SegmentationLoss
from salsanext_cli.training.optimise import Learner
from salsanext_cli.training.plan import Plan
from salsanext_cli.training.recipe import Recipe, recipe
from salsanext_cli.uncertainty.adf import Gaussian
from salsanext_cli.uncertainty.moments import softmax_moments

CPU = torch.device("cpu")
WEIGHTS = torch.tensor([0.0, 1.0, 2.0])
TINY = Recipe(
    epochs=2,
    batch=2,
    crop_width=32,
    optimiser="adamw",
    learning_rate=3e-3,
    schedule="one-cycle",
    average=0.5,
    heteroscedastic=0.01,
)


class Tiny(nn.Sequential):
    """A network of a few hundred weights, of layers that moments have rules for."""

    stride = (1, 1)

    def __init__(self, class_count: int = 20, dropout: float = 0.2) -> None:
        super().__init__(Unit(5, 8, 3), ChannelDropout(dropout), nn.Conv2d(8, class_count, 1))


def draw(*shape: int, seed: int = 0) -> Tensor:
    return torch.randn(*shape, generator=torch.Generator().manual_seed(seed), dtype=torch.float64)


def logits(*shape: int) -> Gaussian:
    return Gaussian(draw(*shape), 0.1 * draw(*shape, seed=1).square())


def slow_term(mean: Tensor, variance: Tensor, truth: Tensor) -> float:
    """Return −log of the normal density but for ½ log 2π, number by number."""
    total = 0.0
    for p, v, t in zip(mean.tolist(), variance.tolist(), truth.tolist(), strict=True):
        for c in range(len(p)):
            density = norm.logpdf(float(c == t), p[c], (v[c] + FLOOR) ** 0.5)
            total -= density + 0.5 * np.log(2 * np.pi)
    return total


def test_the_term_is_the_likelihood_of_the_truth() -> None:
    mean, variance = softmax_moments(draw(7, 4), draw(7, 4, seed=1).square(), 1)
    truth = torch.tensor([0, 1, 1, 3, 0, 1, 3])
    found = float(heteroscedastic(mean, variance, truth))
    assert found == pytest.approx(slow_term(mean, variance, truth), rel=1e-12)


def test_it_is_least_where_the_variance_is_the_squared_error() -> None:
    mean, truth = draw(6, 3).softmax(1), torch.tensor([0, 1, 2, 2, 1, 0])
    error = (torch.eye(3)[truth] - mean).square()
    variance = (error - FLOOR).requires_grad_()
    least = heteroscedastic(mean, variance, truth)
    least.backward()
    assert variance.grad is not None
    assert variance.grad.abs().max() < 1e-8
    for factor in (0.5, 2.0):
        assert heteroscedastic(mean, factor * error - FLOOR, truth) > least


def test_the_loss_is_that_of_the_means_and_the_term_of_what_counts() -> None:
    x, truth = logits(2, 3, 2, 4), torch.tensor([0, 1, 2, 2, 1, 0, 0, 1] * 2).view(2, 2, 4)
    of_mean = SegmentationLoss(WEIGHTS)
    counted = [(b, r, c) for b, r, c in np.ndindex(2, 2, 4) if truth[b, r, c] > 0]
    pixels = [(x.mean[b, :, r, c], x.variance[b, :, r, c]) for b, r, c in counted]
    mean, variance = (
        torch.stack(each) for each in zip(*(softmax_moments(*p, 0) for p in pixels), strict=True)
    )
    term = slow_term(mean, variance, torch.stack([truth[place] for place in counted]))
    expected = float(of_mean(x.mean, truth)) + 0.3 * term / (3 * len(counted))
    found = float(HeteroscedasticLoss(of_mean, 0.3)(x, truth))
    assert found == pytest.approx(expected, rel=1e-12)


def test_the_whole_loss_passes_gradcheck() -> None:
    x, truth = logits(1, 3, 2, 3), torch.tensor([[[0, 1, 2], [2, 1, 1]]])
    loss = HeteroscedasticLoss(SegmentationLoss(WEIGHTS), 0.1)
    pair = x.mean.requires_grad_(), x.variance.add(0.01).requires_grad_()
    assert gradcheck(lambda m, v: loss(Gaussian(m, v), truth), pair, fast_mode=True)


def test_where_nothing_counts_loss_and_gradient_are_zero() -> None:
    mean, variance = (t.requires_grad_() for t in (draw(1, 3, 2, 2), draw(1, 3, 2, 2).square()))
    loss = HeteroscedasticLoss(SegmentationLoss(WEIGHTS), 0.1)
    value = loss(Gaussian(mean, variance), torch.zeros(1, 2, 2, dtype=torch.uint8))
    value.backward()
    assert float(value.detach()) == 0
    assert not mean.grad.any()  # type: ignore[union-attr]
    assert not variance.grad.any()  # type: ignore[union-attr]


def test_without_the_term_nothing_is_wrapped() -> None:
    loss, module = SegmentationLoss(WEIGHTS), Tiny(3)
    assert with_moments(loss, module, Recipe()) == (loss, module)  # type: ignore[arg-type]


def learner(norm: bool = True, **changes: object) -> Learner:
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = Tiny(3, dropout=0.0)
    if not norm:
        module[0][2] = nn.Identity()
    return Learner.of(module, TINY.with_changes(**changes), WEIGHTS, CPU)  # type: ignore[arg-type]


def five() -> tuple[Tensor, Tensor]:
    """Return images that differ in how many pixels count, with their variances."""
    mean = draw(5, 5, 8, 16).float()
    truth = (mean[:, 0] > torch.linspace(-1, 1, 5)[:, None, None]).byte() + 1
    truth[1, :, 5:] = 0
    return torch.cat([mean, 0.1 * mean.square()], 1), truth


@pytest.mark.parametrize("parts", [2, 3])
def test_a_batch_in_parts_has_the_gradient_of_the_whole(parts: int) -> None:
    whole, accumulated = (learner(False, lovasz=0.0, accumulate=n) for n in (1, parts))
    loss = whole.step(*five(), 0, 10)
    assert accumulated.step(*five(), 0, 10) == pytest.approx(loss, rel=1e-6)
    for one, other in zip(whole.module.parameters(), accumulated.module.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-4, atol=1e-6)


def test_what_is_trained_is_the_module_itself() -> None:
    learning = learner()
    before = [p.detach().clone() for p in learning.module.parameters()]
    learning.step(*five(), 0, 10)
    for old, new in zip(before, learning.module.parameters(), strict=True):
        assert not torch.equal(old, new)
    assert learning.average.state_dict().keys() == Tiny(3).state_dict().keys()


# Data sets


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: pytest.TempPathFactory) -> Path:
    root = tmp_path_factory.mktemp("noisy")
    write_sequence(root / "sequences" / "00", ["0", "1", "2"], count=600)
    write_sequence(root / "sequences" / "08", ["0"], count=600)
    return root


def samples(dataset: Path, recipe: Recipe) -> Samples:
    scans = [scan for scan in find_scans(dataset) if scan.sequence == "00"]
    return Samples(scans, label_space(), SMALL, recipe, np.zeros(20, bool))


def test_samples_have_their_variances_behind_them(dataset: Path) -> None:
    still = TINY.with_changes(rotate=0, shift=0, flip=0, drop=0, crop_width=0)
    noisy, plain = samples(dataset, still), samples(dataset, still.with_changes(heteroscedastic=0))
    image, truth, _ = noisy[0, 1]
    expected, same, _ = plain[0, 1]
    assert expected.shape == (5, 16, 128)
    np.testing.assert_array_equal(image[:5], expected)
    np.testing.assert_array_equal(truth, same)
    scan, _ = read_labelled(noisy.files[1], label_space(), SMALL)
    channels = project(scan, SMALL).channels
    np.testing.assert_array_equal(image[5:], input_variance(channels, SMALL))


def trained_term(dataset: Path, weight: float) -> tuple[float, float]:
    """Return the term on all the scans in evaluation mode, before and after twenty steps."""
    still = {"dropout": 0.0, "rotate": 0, "shift": 0, "flip": 0, "drop": 0}
    plan = TINY.with_changes(epochs=10, heteroscedastic=weight, **still)
    given = samples(dataset, plan)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        learning = Learner.of(Tiny(20, 0.0), plan, torch.ones(20), CPU)  # type: ignore[arg-type]
    whole = samples(dataset, plan.with_changes(crop_width=0))
    images, truth = (
        torch.from_numpy(np.stack(each))
        for each in list(zip(*(whole[k, k] for k in range(3)), strict=True))[:2]
    )

    def term() -> float:
        learning.module.eval()
        with torch.no_grad():
            moments = MomentNetwork(learning.module)(images)
            return float(learning.loss.term(moments, truth) / truth.numel())  # type: ignore

    before = term()
    for step, (some, labels, _) in enumerate(batches(given, Plan(3, plan), 0)):
        learning.step(some, labels, step, 2)
    assert step == 19
    return before, term()


def test_twenty_steps_lower_the_term_more_than_without_it(dataset: Path) -> None:
    """The rest of the loss lowers it too, since it makes the errors smaller."""
    before, after = trained_term(dataset, 0.1)
    _, without = trained_term(dataset, 1e-9)
    assert after < without - 0.5 < before


@pytest.fixture
def _tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(ARCHITECTURES, "salsanext", Tiny)  # type: ignore[arg-type]


def go(dataset: Path, run: Path, sensor: Sensor = SMALL, **given: object) -> TrainResult:
    return train(dataset, run, recipe=TINY, sensor=sensor, device="cpu", **given)  # type: ignore


class Stopped(BaseException):
    """Ctrl-C at a chosen step."""


@pytest.mark.usefixtures("_tiny")
def test_an_interrupted_training_ends_as_an_uninterrupted_one(
    dataset: Path, tmp_path: Path
) -> None:
    def interrupt(report: object) -> None:
        if report.step == 3:  # type: ignore[attr-defined]
            raise Stopped

    whole = go(dataset, tmp_path / "whole")
    with pytest.raises(Stopped):
        go(dataset, tmp_path / "parts", progress=interrupt)
    parts = go(dataset, tmp_path / "parts")
    assert parts.last.read_bytes() == whole.last.read_bytes()
    assert read_card(parts.last).recipe["heteroscedastic"] == 0.01


@pytest.mark.usefixtures("_tiny")
@pytest.mark.parametrize(
    ("noise", "what"), [((None, 0.02), "its noise is not known"), ((0.0, 0.0), "noise of 0")]
)
def test_a_sensor_without_known_noise_is_refused_before_anything_is_written(
    dataset: Path, tmp_path: Path, noise: tuple[float | None, float], what: str
) -> None:
    sensor = replace(SMALL, range_noise=noise[0], intensity_noise=noise[1])
    with pytest.raises(UsageError, match=f"sensor small · .*{what}"):
        go(dataset, tmp_path / "run", sensor)
    assert not (tmp_path / "run").exists()


def test_moments_are_float32() -> None:
    with pytest.raises(UsageError, match="key precision · bfloat16 · expected auto or float32"):
        TINY.with_changes(precision="bfloat16")
    assert learner().dtype is torch.float32


def test_the_recipe() -> None:
    assert recipe("heteroscedastic").heteroscedastic > 0
    assert Recipe().heteroscedastic == 0
