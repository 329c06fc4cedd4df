# SPDX-License-Identifier: MIT
from dataclasses import replace

import numpy as np
import pytest
import torch
import yaml
from hypothesis import given
from hypothesis import strategies as st
from scans import refused

from salsanext_cli import LabelSpace, label_space
from salsanext_cli.core.errors import LabelError, UsageError
from salsanext_cli.training.data.targets import class_sets, to_targets
from salsanext_cli.training.losses import SegmentationLoss, lovasz_softmax

PLAIN = label_space()
OTHER = replace(PLAIN, alternatives={40: (9, 10), 60: (9, 10), 70: (15, 16, 17), 50: (13,)})


def test_an_id_of_several_classes_is_the_target_of_their_set() -> None:
    sets = class_sets([PLAIN, OTHER])
    assert sets == ((9, 10), (15, 16, 17))
    raw = np.uint32([10, 40, 60 + (5 << 16), 70, 50, 44, 0])
    targets = to_targets(raw, OTHER, sets, "a.label")
    assert targets.tolist() == [1, 20, 20, 21, 13, 10, 0]
    assert targets.dtype == np.uint8
    assert to_targets(raw, PLAIN, sets, "a.label").tolist() == PLAIN.to_train(raw).tolist()
    assert class_sets([PLAIN]) == ()
    with refused(LabelError, "a.label"):
        to_targets(np.uint32([40, 7]), OTHER, class_sets([OTHER]), "a.label")


def slow_loss(logits, truth, weights, sets):
    """Return the cross-entropy, a pixel at a time."""
    total = weight = 0.0
    for z, target in zip(logits, truth, strict=True):
        members = (target,) if target < len(weights) else sets[target - len(weights)]
        positive = [weights[c] for c in members if weights[c] > 0]
        if positive:
            p = np.exp(z) / np.exp(z).sum()
            total -= min(positive) * np.log(sum(p[c] for c in members))
            weight += min(positive)
    return total / weight if weight else 0.0


@given(st.lists(st.integers(0, 7), min_size=1, max_size=12), st.integers(0, 99))
def test_the_probability_of_a_set_is_the_sum_of_its_classes(truth: list[int], seed: int) -> None:
    """Class 0 is ignored, and so is the set of 0 and a class without a weight."""
    sets, weights = ((1, 2), (0, 4), (1, 2, 3)), np.array([0, 1, 0.5, 3, 0])
    logits = np.random.default_rng(seed).normal(0, 2, (len(truth), 5))
    given_logits = torch.from_numpy(logits.T.reshape(1, 5, 1, -1))
    targets = torch.tensor(truth).reshape(1, 1, -1)
    loss = SegmentationLoss(torch.from_numpy(weights), 0.0, sets)
    expected = slow_loss(logits, np.array(truth), weights, sets)
    assert float(loss(given_logits, targets)) == pytest.approx(expected, abs=1e-9)
    single = [i for i, target in enumerate(truth) if 0 < target < 4]
    both = SegmentationLoss(torch.from_numpy(weights), 1.0, sets)
    flat = torch.from_numpy(logits[single]).softmax(1)
    lovasz = lovasz_softmax(flat, torch.tensor([truth[i] for i in single], dtype=torch.long))
    expected += float(lovasz) if single else 0
    assert float(both(given_logits, targets)) == pytest.approx(expected, abs=1e-9)


def test_label_spaces_with_alternatives_survive_a_round_trip_and_are_checked() -> None:
    text = yaml.safe_dump(OTHER.to_dict())
    back = LabelSpace.from_dict(yaml.safe_load(text))
    assert back.alternatives == OTHER.alternatives
    assert back.fits(PLAIN)
    assert "learning_alternatives 40: [9, 10] ≠ none" in OTHER.differences(PLAIN)
    assert "learning_alternatives" not in PLAIN.to_dict()
    for wrong in ({40: [9, 77]}, {40: [10, 11]}, {7: [1, 2]}, {40: 9}, [40]):
        with pytest.raises(UsageError):
            LabelSpace.from_dict(PLAIN.to_dict() | {"learning_alternatives": wrong})
