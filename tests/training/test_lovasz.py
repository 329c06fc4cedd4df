# SPDX-License-Identifier: MIT
"""Lovász-Softmax against the set function itself, given for every subset of a few pixels."""

from itertools import pairwise

import numpy as np
import numpy.typing as npt
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from salsanext_cli.training.losses import SegmentationLoss, jaccard_gradient, lovasz_softmax

Numbers = npt.NDArray[np.float64]
SIXTHS = st.integers(0, 6).map(lambda k: k / 6)
"""So few that most pixels tie with another."""
SEEDS = st.integers(0, 2**32 - 1)


def subsets(pixels: int) -> npt.NDArray[np.bool_]:
    """Return every set of pixels as a row, (2^P, P); row i holds the bits of i."""
    return (np.arange(2**pixels)[:, None] >> np.arange(pixels) & 1).astype(bool)


def jaccard_losses(members: npt.NDArray[np.bool_]) -> Numbers:
    """Return 1 − |kept| / |class or wrong| for every set of wrong pixels, (2^P,)."""
    wrong = subsets(len(members))
    kept, united = (members & ~wrong).sum(1), (members | wrong).sum(1)
    return 1 - kept / united


def choquet(errors: Numbers, losses: Numbers) -> float:
    """Integrate, over thresholds t, the set function of the pixels whose error exceeds t."""
    edges = sorted({0.0, *errors.tolist()})
    bits = 1 << np.arange(len(errors))
    exceed = [bits[errors > (low + high) / 2].sum() for low, high in pairwise(edges)]
    return float(np.diff(edges) @ losses[np.array(exceed, int)])


def extension(errors: Tensor, members: Tensor) -> Tensor:
    """Return the loss of each row of errors (K, P), as the loss of the package has it."""
    return (errors * jaccard_gradient(errors, members.expand(errors.shape))).sum(1)


@st.composite
def images(draw: st.DrawFn) -> tuple[Numbers, npt.NDArray[np.int64]]:
    """Draw probabilities (P, C) and truth (P,); classes may be absent, errors tie."""
    pixels, classes = draw(st.integers(1, 6)), draw(st.integers(1, 4))
    numbers = draw(st.lists(SIXTHS, min_size=pixels * classes, max_size=pixels * classes))
    truth = draw(st.lists(st.integers(0, classes - 1), min_size=pixels, max_size=pixels))
    return np.reshape(numbers, (pixels, classes)), np.array(truth)


@settings(max_examples=150, deadline=None)
@given(images())
def test_lovasz_is_the_integral_of_the_set_function(
    image: tuple[Numbers, npt.NDArray[np.int64]],
) -> None:
    probabilities, truth = image
    expected = []
    for c in set(truth.tolist()):
        members = truth == c
        errors = np.where(members, 1 - probabilities[:, c], probabilities[:, c])
        expected.append(choquet(errors, jaccard_losses(members)))
    ours = lovasz_softmax(torch.from_numpy(probabilities), torch.from_numpy(truth))
    assert float(ours) == pytest.approx(np.mean(expected), abs=1e-12)


@pytest.mark.parametrize("pixels", [1, 2, 5])
def test_where_pixels_are_right_or_wrong_it_is_the_set_function(pixels: int) -> None:
    """For every class and every set of wrong pixels."""
    sets = subsets(pixels)
    for members in sets[1:]:
        found = extension(torch.from_numpy(sets).double(), torch.from_numpy(members))
        np.testing.assert_allclose(found, jaccard_losses(members), rtol=0, atol=1e-14)


@settings(max_examples=60, deadline=None)
@given(SEEDS, st.integers(1, 12), st.floats(0, 1))
def test_it_is_convex(seed: int, pixels: int, share: float) -> None:
    """Along segments, and above the plane that its gradient is, at ties too."""
    random = np.random.default_rng(seed)
    # Of one digit, so that pixels tie.
    one, other = (torch.from_numpy(random.random((20, pixels)).round(1)) for _ in range(2))
    members = torch.from_numpy(random.random(pixels) < 0.5)
    members[random.integers(pixels)] = True
    between = extension(share * one + (1 - share) * other, members)
    ends = extension(one, members), extension(other, members)
    assert (between <= share * ends[0] + (1 - share) * ends[1] + 1e-12).all()
    slope = jaccard_gradient(one, members.expand(one.shape))
    assert (ends[1] >= ends[0] + (slope * (other - one)).sum(1) - 1e-12).all()


@settings(max_examples=40, deadline=None)
@given(SEEDS, st.integers(1, 10))
def test_the_order_of_the_pixels_changes_nothing(seed: int, pixels: int) -> None:
    random = np.random.default_rng(seed)
    probabilities = torch.from_numpy(random.integers(0, 3, (pixels, 3)) / 2)
    truth = torch.from_numpy(random.integers(0, 3, pixels))
    order = torch.from_numpy(random.permutation(pixels))
    ours = lovasz_softmax(probabilities, truth)
    torch.testing.assert_close(lovasz_softmax(probabilities[order], truth[order]), ours)


def test_one_pixel_that_counts_among_ignored_ones() -> None:
    """-log p + (1 − p), whatever the others are; nothing pulls at them."""
    logits = torch.tensor([[1.0, 2.0, 0.5], [torch.inf, -torch.inf, 0], [torch.nan, 0, 0]])
    logits = logits.double().t().reshape(1, 3, 1, 3).clone().requires_grad_()
    loss = SegmentationLoss(torch.tensor([0.0, 1.0, 3.0]))(logits, torch.tensor([[[1, 0, 0]]]))
    loss.backward()
    p = logits.detach()[0, :, 0, 0].softmax(0)[1]
    assert float(loss.detach()) == pytest.approx(float(1 - p - p.log()))
    assert logits.grad is not None
    assert logits.grad[..., 0].isfinite().all()
    assert not logits.grad[..., 1:].any()


def test_no_image_has_loss_zero() -> None:
    logits = torch.zeros(0, 3, 2, 2, requires_grad=True)
    loss = SegmentationLoss(torch.ones(3))(logits, torch.zeros(0, 2, 2, dtype=torch.uint8))
    loss.backward()
    assert float(loss.detach()) == 0
    assert logits.grad is not None
