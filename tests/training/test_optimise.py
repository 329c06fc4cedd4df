# SPDX-License-Identifier: MIT
import copy
import math
from dataclasses import replace

import pytest
import torch
from tiny_network import TinyNetwork
from torch import Tensor, nn

from salsanext_cli.training.distributed import ProcessGroup
from salsanext_cli.training.losses import SegmentationLoss
from salsanext_cli.training.optimise import Learner, build_optimiser, update_average
from salsanext_cli.training.recipe import Recipe

CPU = torch.device("cpu")
WEIGHTS = torch.tensor([0.0, 1.0, 2.0])


def batch(seed: int = 0) -> tuple[Tensor, Tensor]:
    random = torch.Generator().manual_seed(seed)
    images = torch.randn(2, 5, 16, 32, generator=random)
    return images, (images[:, 0] > 0).byte() + 1


def learner(**changes: object) -> Learner:
    recipe = Recipe(batch=2, warm_up=0.0).with_changes(**changes)
    with torch.random.fork_rng():
        torch.manual_seed(0)
        module = TinyNetwork(3, dropout=recipe.dropout)
    return Learner.of(module, recipe, WEIGHTS, CPU)


def test_sgd_is_the_papers() -> None:
    """Two steps against the update rule written out: momentum 0.9, decay added to the gradient."""
    weight = torch.tensor([2.0])
    layer = nn.Linear(1, 1, bias=False)
    layer.weight.data[:] = weight
    optimiser = build_optimiser(layer, Recipe())
    speed = torch.zeros(1)
    for _ in range(2):
        optimiser.zero_grad()
        layer(torch.ones(1, 1)).square().sum().backward()
        optimiser.step()
        speed = 0.9 * speed + 2 * weight + 1e-4 * weight
        weight = weight - 0.01 * speed
    torch.testing.assert_close(layer.weight.detach()[0], weight)


def test_the_loss_falls() -> None:
    learning = learner(optimiser="adamw", learning_rate=0.01, dropout=0.0)
    losses = [learning.step(*batch(), step, 10) for step in range(30)]
    assert losses[-1] < 0.6 * losses[0]


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


def test_dropout_differs_from_step_to_step() -> None:
    losses = [learner(dropout=0.5).step(*batch(), step, 10) for step in range(2)]
    assert losses[0] != losses[1]


def test_a_loss_that_is_not_finite_changes_no_weight() -> None:
    learning = learner()
    before = copy.deepcopy(dict(learning.module.named_parameters()))
    images, truth = batch()
    images[0, 0, 3, 3] = math.nan
    assert math.isnan(learning.step(images, truth, 0, 10))
    for name, parameter in learning.module.named_parameters():
        assert torch.equal(parameter, before[name])


@pytest.mark.parametrize("clip", [0.0, 1.0])
def test_a_gradient_that_is_not_finite_changes_no_weight(clip: float) -> None:
    learning = learner(clip_gradient=clip, average=0.5)
    learning.module.features.weight.register_hook(lambda gradient: gradient * math.inf)
    before = [copy.deepcopy(m.state_dict()) for m in (learning.module, learning.average)]
    assert math.isnan(learning.step(*batch(), 0, 10))
    for module, kept in zip((learning.module, learning.average), before, strict=True):
        for name, parameter in module.named_parameters():
            assert torch.equal(parameter, kept[name])


def test_clipping_bounds_the_gradient() -> None:
    learning = learner(clip_gradient=1e-3)
    learning.step(*batch(), 0, 10)
    norms = [p.grad.norm() for p in learning.module.parameters() if p.grad is not None]
    assert float(torch.stack(norms).norm()) == pytest.approx(1e-3, rel=1e-3)


def test_the_average_moves_slowly_and_takes_batch_norm_along() -> None:
    kept, new = nn.BatchNorm2d(1), nn.BatchNorm2d(1)
    new.weight.data.fill_(3.0)
    new.running_mean.fill_(1.0)
    new.num_batches_tracked.fill_(7)
    update_average(kept, new, 0.9, step=1000)
    assert float(kept.weight.detach()) == pytest.approx(1.2)
    assert float(kept.running_mean) == pytest.approx(0.1)
    assert int(kept.num_batches_tracked) == 7


def test_the_first_steps_of_an_average_forget_the_random_weights() -> None:
    kept, new = nn.Linear(1, 1), nn.Linear(1, 1)
    kept.weight.data.fill_(0.0)
    new.weight.data.fill_(1.0)
    for step in range(30):
        update_average(kept, new, 0.999, step)
    assert float(kept.weight.detach()) > 0.99


def test_without_an_average_the_module_is_what_is_kept() -> None:
    assert (without := learner()).average is without.module
    averaged = learner(average=0.9)
    assert averaged.average is not averaged.module
    averaged.step(*batch(), 0, 10)
    assert not averaged.average.training


def without_norm(**changes: object) -> Learner:
    """Return a learner of a network whose images know nothing of each other."""
    learning = learner(dropout=0.0, batch=5, learning_rate=1e-9, **changes)
    learning.module.norm = nn.Identity()  # type: ignore[assignment]
    return learning


def five() -> tuple[Tensor, Tensor]:
    """Return images that differ in how many pixels count, and of which class."""
    images = torch.randn(5, 5, 16, 32, generator=torch.Generator().manual_seed(3))
    truth = (images[:, 0] > torch.linspace(-1, 1, 5)[:, None, None]).byte() + 1
    truth[1, :, 5:] = 0
    return images, truth


@pytest.mark.parametrize("parts", [2, 3, 5, 9])
@pytest.mark.parametrize("smoothing", [0.0, 0.3])
def test_a_batch_in_parts_has_the_gradient_of_the_whole(parts: int, smoothing: float) -> None:
    given = {"lovasz": 0.0, "label_smoothing": smoothing}
    whole, accumulated = without_norm(**given), without_norm(**given, accumulate=parts)
    loss = whole.step(*five(), 0, 10)
    assert accumulated.step(*five(), 0, 10) == pytest.approx(loss, rel=1e-6)
    for one, other in zip(whole.module.parameters(), accumulated.module.parameters(), strict=True):
        torch.testing.assert_close(one.grad, other.grad, rtol=1e-5, atol=1e-7)


def test_lovasz_is_the_mean_of_the_parts() -> None:
    """The step beside the same loss put together by hand from the losses of the parts."""
    images, truth = five()
    learning = without_norm(accumulate=2)
    entropy, both = (SegmentationLoss(WEIGHTS, lovasz) for lovasz in (0.0, 1.0))
    with torch.no_grad():
        logits = learning.module(images)
    parts = [slice(0, 3), slice(3, 5)]
    lovasz = [both(logits[p], truth[p]) - entropy(logits[p], truth[p]) for p in parts]
    expected = float(entropy(logits, truth) + (lovasz[0] + lovasz[1]) / 2)
    assert learning.step(images, truth, 0, 10) == pytest.approx(expected, rel=1e-6)


def test_a_batch_in_parts_where_nothing_counts() -> None:
    learning = without_norm(accumulate=2)
    images, truth = five()
    assert learning.step(images, truth * 0, 0, 10) == 0
    for parameter in learning.module.parameters():
        assert not parameter.grad.any()


def test_parts_are_one_step_for_average_and_optimiser() -> None:
    learning = learner(accumulate=2, average=0.9, optimiser="adamw")
    learning.step(*batch(), 0, 10)
    assert {float(state["step"]) for state in learning.optimiser.state.values()} == {1.0}


@pytest.mark.parametrize("size", [1, 4, 8, 16, 24])
@pytest.mark.parametrize("accumulate", [1, 3])
def test_a_part_of_whole_circles_holds_no_more_than_one_of_windows(
    size: int, accumulate: int
) -> None:
    """Or one circle; and no worker has more parts than images."""
    recipe = Recipe(batch=24, accumulate=accumulate, crop_width=512, whole_epochs=1)
    module = TinyNetwork(3)
    learning = replace(Learner.of(module, recipe, WEIGHTS, CPU), group=ProcessGroup(0, size))
    share = -(-24 // size)
    windows = -(-share // learning._parts(512)) * 512
    assert learning._parts(512) == min(accumulate, 24 // size)
    parts = learning._parts(2048)
    assert parts <= 24 // size
    assert -(-share // parts) * 2048 <= max(windows, 2048) or parts == 24 // size
