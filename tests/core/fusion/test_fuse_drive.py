# SPDX-License-Identifier: MIT
"""Fusion of a drive in memory: votes of equal scans, and a scan that cannot be read."""

import numpy as np
import pytest

from salsanext_cli import label_space
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fusion.drive import Drive
from salsanext_cli.core.fusion.fuse_drive import VotingScan, fuse_drive
from salsanext_cli.core.fusion.top_classes import top_classes

SPACE = label_space()
ROAD = SPACE.names.index("road")
BUILDING = SPACE.names.index("building")
POINTS = np.float32([[5, 0, 0], [8, 3, 1], [0, 20, 2]])


def scan(*probabilities):
    """Return a scan whose points have these classes with these probabilities."""
    softmax = np.zeros((len(POINTS), SPACE.class_count), np.float32)
    for number, probability in probabilities:
        softmax[:, number] = probability
    labels = softmax.argmax(axis=1).astype(np.uint8)
    return VotingScan(points=lambda: POINTS, labels=labels, votes=top_classes(softmax))


def standing(count):
    return Drive(np.tile(np.eye(4), (count, 1, 1)), np.zeros(count, np.int64))


def test_a_sure_scan_outvotes_an_unsure_one():
    unsure = scan((BUILDING, 0.6), (ROAD, 0.4))
    sure = scan((ROAD, 1.0))
    for fused in fuse_drive([unsure, sure], standing(2), SPACE):
        assert (fused.labels == ROAD).all()
        assert fused.disagreement == pytest.approx(1 - (0.4 + 1.0) / 2, abs=0.005)


def test_a_scan_that_cannot_be_read_has_its_error_and_does_not_vote():
    def fail():
        raise FormatError("b.bin", "is damaged")

    damaged = scan((ROAD, 1.0))
    damaged = VotingScan(points=fail, labels=damaged.labels, votes=damaged.votes)
    first = scan((BUILDING, 0.6), (ROAD, 0.4))
    fused, error = fuse_drive([first, damaged], standing(2), SPACE)
    assert (fused.labels == BUILDING).all()
    assert fused.disagreement == pytest.approx(0.4, abs=0.005)
    assert isinstance(error, FormatError)
