# SPDX-License-Identifier: MIT
"""Losses against the set function itself, slow loops and torch's own."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st
from torch.nn import functional as F

from salsanext_cli.training import losses
from salsanext_cli.training.data.class_counts import class_weights
from salsanext_cli.training.losses import SegmentationLoss, jaccard_gradient, lovasz_softmax

Numbers = npt.NDArray[np.float64]
SIXTHS = st.integers(0, 6).map(lambda k: k / 6)
"""Few values, so that most pixels tie with another."""


def jaccard_losses(members: npt.NDArray[np.bool_]) -> Numbers:
    """Return 1 − |right| / |class or wrong| for each set of wrong pixels, (2^P,) (Berman, eq. 6).

    The bits of i are the pixels of set i.
    """
    wrong = (np.arange(2 ** len(members))[:, None] >> np.arange(len(members)) & 1).astype(bool)
    return 1 - (members & ~wrong).sum(1) / (members | wrong).sum(1)


def choquet(errors: Numbers, losses: Numbers) -> float:
    """Integrate, over thresholds t, the set function of the pixels whose error exceeds t."""
    edges = sorted({0.0, *errors.tolist()})
    bits = 1 << np.arange(len(errors))
    exceed = [bits[errors > (low + high) / 2].sum() for low, high in pairwise(edges)]
    return float(np.diff(edges) @ losses[np.array(exceed, int)])


@st.composite
def images(draw: st.DrawFn) -> tuple[Numbers, npt.NDArray[np.int64]]:
    """Draw probabilities (P, C) and truth (P,); classes may be absent, errors tie."""
    pixels, classes = draw(st.integers(1, 6)), draw(st.integers(1, 4))
    numbers = draw(st.lists(SIXTHS, min_size=pixels * classes, max_size=pixels * classes))
    truth = draw(st.lists(st.integers(0, classes - 1), min_size=pixels, max_size=pixels))
    return np.reshape(numbers, (pixels, classes)), np.array(truth)


@given(images())
def test_lovasz_is_the_integral_of_the_set_function(image):
    probabilities, truth = image
    expected = []
    for c in set(truth.tolist()):
        members = truth == c
        errors = np.where(members, 1 - probabilities[:, c], probabilities[:, c])
        expected.append(choquet(errors, jaccard_losses(members)))
    ours = lovasz_softmax(torch.from_numpy(probabilities), torch.from_numpy(truth))
    assert ours.ndim == 0
    assert float(ours) == pytest.approx(np.mean(expected), abs=1e-12)


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
    gradient = jaccard_gradient(errors[None], foreground[None])[0].numpy()
    # Differences of numbers next to 1 are exact to their last bit only.
    np.testing.assert_allclose(gradient, expected, rtol=1e-6, atol=2e-16)


def test_the_loss_is_the_sum_of_its_terms_and_passes_gradcheck():
    random = torch.Generator().manual_seed(4)
    logits = torch.randn(1, 4, 2, 3, dtype=torch.float64, generator=random, requires_grad=True)
    truth = torch.tensor([[[0, 1, 2], [3, 1, 1]]])
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 2.0, 3.0]))
    assert torch.autograd.gradcheck(lambda x: loss(x, truth), (logits,))
    weights = torch.tensor([0.0, 1.0, 3.0])
    logits, truth = torch.randn(2, 3, 4, 4), torch.randint(1, 3, (2, 4, 4)).byte()
    entropy = F.cross_entropy(logits, truth.long(), weights)
    flat = logits.movedim(1, -1).reshape(-1, 3)
    lovasz = lovasz_softmax(flat.softmax(1), truth.long().flatten())
    torch.testing.assert_close(SegmentationLoss(weights, 0)(logits, truth), entropy)
    torch.testing.assert_close(SegmentationLoss(weights, 0.5)(logits, truth), entropy + lovasz / 2)


@pytest.mark.parametrize("images", [0, 2])
def test_without_a_scored_pixel_loss_and_gradient_are_zero(images: int) -> None:
    logits = torch.randn(images, 4, 3, 5, requires_grad=True)
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 1.0, 0.0]))
    value = loss(logits, torch.tensor([0, 3]).repeat(15)[: 15 * images].reshape(images, 3, 5))
    value.backward()
    assert value.shape == ()
    assert float(value.detach()) == 0
    assert not logits.grad.any()


def test_logits_may_be_large() -> None:
    """log(clamp(softmax)) loses the gradient here; log_softmax keeps it."""
    logits = torch.tensor([[200.0, -200.0]]).reshape(1, 2, 1, 1).requires_grad_()
    loss = SegmentationLoss(torch.ones(2))(logits, torch.ones(1, 1, 1, dtype=torch.long))
    loss.backward()
    assert float(loss.detach()) == pytest.approx(401)
    assert logits.grad[0, 0, 0, 0] == pytest.approx(1)


def test_class_weights_are_inverse_square_roots_of_shares() -> None:
    counts = np.array([1000, 1, 99, 0, 300])
    scored = np.array([False, True, True, True, True])
    weights = class_weights(counts, scored)
    assert weights.dtype == torch.float32
    expected = [0, np.sqrt(400), np.sqrt(400 / 99), 0, np.sqrt(400 / 300)]
    np.testing.assert_allclose(weights.numpy(), expected, rtol=1e-6)
    # 1/(f + 0.001), as published code has it, would stretch this far beyond √99.
    assert float(weights[1] / weights[2]) == pytest.approx(np.sqrt(99), rel=1e-6)


def test_without_a_choice_of_pixels_and_classes_the_loss_is_the_same(monkeypatch):
    """As on a GPU: all pixels and all classes are sorted, and those that do not count are last."""
    random = torch.Generator().manual_seed(4)
    logits = torch.randn(2, 5, 6, 7, dtype=torch.float64, generator=random, requires_grad=True)
    # Class 0 is not scored, class 3 is absent, target 5 is a set.
    truth = torch.tensor([0, 1, 2, 4, 5])[torch.randint(5, (2, 6, 7), generator=random)]
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 2.0, 3.0, 4.0]), 0.7, ((1, 2),))
    expected = loss(logits, truth)
    (gradient,) = torch.autograd.grad(expected, logits)
    pixels = logits.movedim(1, -1).reshape(-1, 5)
    monkeypatch.setattr(losses, "sorted_classes", lambda *_: torch.arange(5))
    found = loss.pixel_loss(pixels, truth.flatten())
    (other,) = torch.autograd.grad(found, logits)
    torch.testing.assert_close(found, expected)
    torch.testing.assert_close(other, gradient)
