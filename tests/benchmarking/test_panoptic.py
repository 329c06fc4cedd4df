# SPDX-License-Identifier: MIT
"""Panoptic quality, compared with figures of the benchmark's program."""

import numpy as np
import pytest
from panoptic import COLUMNS, count_segments, panoptic_quality

from salsanext_cli.io.label_spaces import label_space

RAW_IDS = (40, 60, 48, 50, 51, 10, 10, 252, 30, 254, 18, 31, 20, 52, 0)
OFFICIAL = {
    "all": (0.19923739864758774, 0.3381866431756277, 0.27708344086761527),
    "things": (0.20823626426675318, 0.427884874683367, 0.2986528822055138),
    "stuff": (0.19269276910637653, 0.27295156571545376, 0.2613965744400527),
    "road": (0.42853135559842115, 0.7040157984831205, 0.6086956521739131),
    "car": (0.31731707967382744, 0.6346341593476549, 0.5),
    "truck": (0.5029280320542456, 0.7543920480813685, 0.6666666666666666),
    "person": (0.5040343701968193, 0.684046645267112, 0.7368421052631579),
    "sidewalk": (0.49083557951482476, 0.8180592991913747, 0.6),
    "parking": (0.0, 0.0, 0.0),
}
"""Printed by `evaluate_panoptic.py` of PRBonn/semantic-kitti-api at commit a9c749e, with its own
label space, for the two scans of `scans_of_segments`: PQ, SQ, RQ."""


def scans_of_segments():
    """Return truth and prediction, raw labels (N,) uint32, of two scans of 60 segments each."""
    random = np.random.RandomState(7)  # Its numbers are the same in every version of NumPy.
    for _ in range(2):
        truth, predicted = [], []
        for number in range(60):
            label = random.choice(RAW_IDS) | random.randint(3) << 16
            numbered = label & 0xFFFF | number << 16 if random.rand() < 0.5 else label
            size = random.randint(1, 120)
            missed = random.randint(size // 2 + 1)
            truth += [label] * size
            predicted += [numbered] * (size - missed) + [random.choice(RAW_IDS)] * missed
        yield np.array(truth, np.uint32), np.array(predicted, np.uint32)


def test_qualities_are_those_of_the_official_program():
    space = label_space()
    counts = 0
    for raw in scans_of_segments():
        truth, predicted = ((space.to_train(labels), labels) for labels in raw)
        counts = counts + count_segments(truth, predicted, space.scored)
    quality = panoptic_quality(counts, space, space.movable)
    quality |= quality.pop("classes")
    for name, expected in OFFICIAL.items():
        assert [quality[name][key] for key in COLUMNS[:3]] == pytest.approx(expected, rel=1e-12)
