# SPDX-License-Identifier: MIT
from itertools import product

import numpy as np
import pytest
import torch
from torch.nn import functional as F

from salsanext_cli.training.losses import (
    SegmentationLoss,
    WholeBatch,
    class_weights,
    jaccard_gradient,
    lovasz_softmax,
    weighted_cross_entropy,
)


def jaccard_loss(mispredicted: set[int], members: set[int]) -> float:
    """1 - intersection over union when a set of pixels is mispredicted (Berman et al., eq. 6)."""
    return len(mispredicted) / len(members | mispredicted)


def lovasz_by_sets(probabilities: np.ndarray, truth: np.ndarray) -> float:
    """Evaluate the set function once per pixel, as the definition has it (eq. 8)."""
    losses = []
    for c in np.unique(truth):
        members = set(np.flatnonzero(truth == c).tolist())
        errors = np.where(truth == c, 1 - probabilities[:, c], probabilities[:, c])
        order = np.argsort(-errors, kind="stable").tolist()
        steps = [
            jaccard_loss(set(order[: i + 1]), members) - jaccard_loss(set(order[:i]), members)
            for i in range(len(order))
        ]
        losses.append(float(np.dot(errors[order], steps)))
    return float(np.mean(losses))


@pytest.mark.parametrize("seed", range(5))
def test_lovasz_is_the_extension_of_the_set_function(seed: int) -> None:
    random = np.random.default_rng(seed)
    probabilities = random.dirichlet(np.ones(4), 11)
    truth = random.integers(0, 3, 11)  # class 3 is absent
    ours = lovasz_softmax(torch.from_numpy(probabilities), torch.from_numpy(truth))
    assert ours.ndim == 0
    assert float(ours) == pytest.approx(lovasz_by_sets(probabilities, truth), abs=1e-12)


@pytest.mark.parametrize("truth", list(product(range(3), repeat=4)))
def test_for_hard_predictions_lovasz_is_one_minus_the_mean_iou(truth: tuple[int, ...]) -> None:
    predicted, actual = np.array([0, 1, 2, 1]), np.array(truth)
    iou = [
        np.sum((actual == c) & (predicted == c)) / np.sum((actual == c) | (predicted == c))
        for c in np.unique(actual)
    ]
    ours = lovasz_softmax(torch.eye(3)[predicted], torch.from_numpy(actual))
    assert float(ours) == pytest.approx(1 - np.mean(iou), abs=1e-6)


def test_the_jaccard_gradient_keeps_the_order_of_the_pixels() -> None:
    errors = torch.tensor([[0.1, 0.9, 0.5]])
    foreground = torch.tensor([[True, False, True]])
    # Sets in order of error: {1}: 1/3, {1, 2}: 2/3, {0, 1, 2}: 3/3.
    torch.testing.assert_close(jaccard_gradient(errors, foreground), torch.full((1, 3), 1 / 3))


def test_the_jaccard_gradient_of_many_pixels_keeps_its_digits() -> None:
    count = 1_000_000
    random = torch.Generator().manual_seed(2)
    # All unlike, so that there is one order only.
    errors = torch.randperm(count, generator=random).float() / count
    foreground = torch.rand(count, generator=random) < 0.3
    falling = errors.numpy().argsort()[::-1]
    hits = np.cumsum(foreground.numpy()[falling])
    loss = 1 - (hits[-1] - hits) / (hits[-1] + np.arange(1, count + 1) - hits)
    expected = np.empty(count)
    expected[falling] = np.diff(loss, prepend=0)
    found = jaccard_gradient(errors[None], foreground[None])[0].numpy()
    # Differences of numbers next to 1 are themselves only good to their last bit.
    np.testing.assert_allclose(found, expected, rtol=1e-6, atol=2e-16)


def test_lovasz_gradient_is_that_of_its_value() -> None:
    random = torch.Generator().manual_seed(3)
    logits = torch.randn(7, 4, dtype=torch.float64, generator=random, requires_grad=True)
    truth = torch.tensor([0, 1, 1, 3, 0, 1, 3])
    assert torch.autograd.gradcheck(lambda x: lovasz_softmax(x.softmax(1), truth), (logits,))


def test_the_whole_loss_passes_gradcheck() -> None:
    random = torch.Generator().manual_seed(4)
    logits = torch.randn(1, 4, 2, 3, dtype=torch.float64, generator=random, requires_grad=True)
    truth = torch.tensor([[[0, 1, 2], [3, 1, 1]]])
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 2.0, 3.0]))
    assert torch.autograd.gradcheck(lambda x: loss(x, truth), (logits,))


@pytest.mark.parametrize("pixels", [0, 1])
def test_lovasz_of_no_pixel_and_of_one(pixels: int) -> None:
    logits = torch.randn(pixels, 5, requires_grad=True)
    truth = torch.full((pixels,), 2)
    loss = lovasz_softmax(logits.softmax(1), truth)
    loss.backward()
    assert loss.shape == ()
    expected = 1 - float(logits.detach().softmax(1)[0, 2]) if pixels else 0.0
    assert float(loss.detach()) == pytest.approx(expected, abs=1e-6)
    assert logits.grad is not None
    assert torch.isfinite(logits.grad).all()


def test_a_batch_of_ignored_pixels_has_loss_and_gradient_zero() -> None:
    logits = torch.randn(2, 4, 3, 5, requires_grad=True)
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 1.0, 0.0]))
    value = loss(logits, torch.tensor([0, 3]).repeat(15).reshape(2, 3, 5))
    value.backward()
    assert value.shape == ()
    assert float(value.detach()) == 0
    assert logits.grad is not None
    assert not logits.grad.any()


def test_ignored_pixels_change_nothing() -> None:
    weights = torch.tensor([0.0, 1.0, 3.0])
    logits = torch.randn(1, 3, 2, 4)
    truth = torch.tensor([[[1, 2, 0, 0], [2, 1, 0, 0]]])
    whole = SegmentationLoss(weights)(logits, truth)
    part = SegmentationLoss(weights)(logits[..., :2], truth[..., :2])
    torch.testing.assert_close(whole, part)


def test_loss_is_the_sum_of_its_terms() -> None:
    weights = torch.tensor([0.0, 1.0, 3.0])
    logits, truth = torch.randn(2, 3, 4, 4), torch.randint(1, 3, (2, 4, 4))
    entropy = F.cross_entropy(logits, truth, weights)
    flat = logits.movedim(1, -1).reshape(-1, 3)
    lovasz = lovasz_softmax(flat.softmax(1), truth.flatten())
    torch.testing.assert_close(SegmentationLoss(weights, 0)(logits, truth), entropy)
    torch.testing.assert_close(SegmentationLoss(weights, 0.5)(logits, truth), entropy + lovasz / 2)


def test_truth_may_be_bytes() -> None:
    loss = SegmentationLoss(torch.ones(3))
    logits, truth = torch.randn(1, 3, 2, 2), torch.tensor([[[0, 1], [2, 1]]])
    torch.testing.assert_close(loss(logits, truth.byte()), loss(logits, truth))


def test_logits_may_be_large() -> None:
    """log(clamp(softmax)) loses the gradient here; log_softmax keeps it."""
    logits = torch.tensor([[200.0, -200.0]]).reshape(1, 2, 1, 1).requires_grad_()
    loss = SegmentationLoss(torch.ones(2))(logits, torch.ones(1, 1, 1, dtype=torch.long))
    loss.backward()
    assert float(loss.detach()) == pytest.approx(401)
    assert logits.grad is not None
    assert logits.grad[0, 0, 0, 0] == pytest.approx(1)


def test_weighted_cross_entropy_is_torchs() -> None:
    weights, truth = torch.rand(5) + 0.1, torch.randint(0, 5, (30,))
    log_probabilities = torch.randn(30, 5).log_softmax(1)
    ours = weighted_cross_entropy(log_probabilities, truth, weights)
    torch.testing.assert_close(ours, F.nll_loss(log_probabilities, truth, weights))


def test_smoothed_with_equal_weights_it_is_torchs() -> None:
    truth, logits = torch.randint(0, 5, (30,)), torch.randn(30, 5)
    ours = weighted_cross_entropy(logits.log_softmax(1), truth, torch.full((5,), 3.0), None, 0.2)
    weights = torch.full((5,), 3.0)
    torch.testing.assert_close(ours, F.cross_entropy(logits, truth, weights, label_smoothing=0.2))


def test_smoothed_it_is_the_weighted_mean_of_torchs_pixels() -> None:
    weights, truth, logits = torch.rand(5) + 0.1, torch.randint(0, 5, (30,)), torch.randn(30, 5)
    ours = weighted_cross_entropy(logits.log_softmax(1), truth, weights, None, 0.2)
    each = F.cross_entropy(logits, truth, label_smoothing=0.2, reduction="none")
    torch.testing.assert_close(ours, (weights[truth] * each).sum() / weights[truth].sum())


def test_smoothing_gives_nothing_to_ignored_classes() -> None:
    """A slow loop over pixels and classes; classes 0 and 3 are ignored, in the truth too."""
    weights = np.array([0.0, 1.0, 4.0, 0.0, 0.5])
    random = np.random.default_rng(3)
    logits, truth = random.normal(0, 2, (5, 24)), random.integers(0, 5, 24)
    total = weight = 0.0
    for pixel, label in enumerate(truth):
        if weights[label] == 0:
            continue
        each = np.exp(logits[:, pixel])
        wanted = dict.fromkeys((1, 2, 4), 0.1 / 3)
        wanted[label] += 0.9
        total -= weights[label] * sum(t * np.log(each[c] / each.sum()) for c, t in wanted.items())
        weight += weights[label]
    given = torch.from_numpy(logits).reshape(1, 5, 4, 6).requires_grad_()
    loss = SegmentationLoss(torch.from_numpy(weights), 0.0, 0.1)
    value = loss(given, torch.from_numpy(truth).reshape(1, 4, 6))
    assert float(value.detach()) == pytest.approx(total / weight, rel=1e-12)
    value.backward()
    assert given.grad is not None
    assert (given.grad[:, [0, 3]] >= 0).all()  # pushed down wherever anything is
    ignored = torch.from_numpy(np.isin(truth, [0, 3])).reshape(4, 6)
    assert not given.grad[0, :, ignored].any()


def test_the_best_prediction_of_a_smoothed_truth_does_not_depend_on_the_weights() -> None:
    """`F.cross_entropy` would want 0.25 of class 0 here, and 0.75 of the rarest."""
    weights, truth = torch.tensor([1.0, 1.0, 59.0]), torch.zeros(1, dtype=torch.long)
    best = torch.tensor([[0.9 + 0.1 / 3, 0.1 / 3, 0.1 / 3]], dtype=torch.float64).log()
    best.requires_grad_()
    loss = weighted_cross_entropy(best.log_softmax(1), truth, weights.double(), None, 0.1)
    loss.backward()
    assert best.grad is not None
    torch.testing.assert_close(best.grad, torch.zeros_like(best), rtol=0, atol=1e-12)


def test_smoothed_parts_add_up_to_the_whole() -> None:
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 3.0]), 0.0, 0.2)
    logits, truth = torch.randn(4, 3, 5, 5), torch.randint(0, 3, (4, 5, 5))
    whole = WholeBatch(loss.weight_of(truth), 2)
    parts = [loss(logits[p], truth[p], whole) for p in (slice(0, 1), slice(1, 4))]
    torch.testing.assert_close(parts[0] + parts[1], loss(logits, truth))


def test_the_smoothed_loss_of_ignored_pixels_is_zero() -> None:
    loss = SegmentationLoss(torch.tensor([0.0, 1.0]), 1.0, 0.1)
    assert float(loss(torch.randn(1, 2, 3, 3), torch.zeros(1, 3, 3, dtype=torch.long))) == 0
    assert float(SegmentationLoss(torch.zeros(2), 1.0, 0.1)(torch.randn(1, 2, 1, 1),
                                                            torch.zeros(1, 1, 1))) == 0  # fmt: skip


def test_class_weights_are_inverse_square_roots_of_shares() -> None:
    counts = np.array([1000, 1, 99, 0, 300])
    scored = np.array([False, True, True, True, True])
    weights = class_weights(counts, scored)
    assert weights.dtype == torch.float32
    expected = [0, np.sqrt(400), np.sqrt(400 / 99), 0, np.sqrt(400 / 300)]
    np.testing.assert_allclose(weights.numpy(), expected, rtol=1e-6)
    # 1/(f + 0.001), as published code has it, would stretch this far beyond √99.
    assert float(weights[1] / weights[2]) == pytest.approx(np.sqrt(99), rel=1e-6)
