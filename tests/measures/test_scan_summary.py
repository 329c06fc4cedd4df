# SPDX-License-Identifier: MIT
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scans import SMALL

from salsanext_cli import LabelSpace, label_space
from salsanext_cli.fitting.scan_checks import Finding, ScanCheck
from salsanext_cli.measures.scan_summary import RunSummary, ScanSummary
from salsanext_cli.results.layout import ScanFile

SPACE = label_space()
FILE = ScanFile("08", "000000", Path("000000.bin"))
SCANS = st.lists(st.lists(st.integers(0, SPACE.class_count - 1), max_size=30), max_size=5)


@given(SCANS)
def test_the_largest_classes_are_those_counted_slowly(scans):
    summary = RunSummary(SMALL, SPACE)
    for train_ids in scans:
        labels = np.array(train_ids, np.uint8)
        summary.add(ScanSummary.of_labels(FILE, labels, SPACE))
    counts = Counter(SPACE.names[i] for train_ids in scans for i in train_ids)
    found = summary.largest_classes()
    assert all(share == counts[name] / counts.total() for name, share in found.items())
    largest = [count / counts.total() for _, count in counts.most_common(5)]
    assert list(found.values()) == largest


def test_labels_of_little_probability_are_doubted():
    labels = np.arange(1000, dtype=np.uint8) % 20
    for confidence, codes in ((0.5, ["low-confidence"]), (0.6, [])):
        found = ScanSummary.of_labels(FILE, labels, SPACE, confidence=confidence)
        assert [finding.code for finding in found.check.findings] == codes


def space_of(count):
    same = {i: i for i in range(count)}
    names = {i: str(i) for i in same}
    maps = {"learning_map": same, "learning_map_inv": same}
    return LabelSpace.from_dict({"labels": names, **maps})


@pytest.mark.parametrize(
    ("count", "share", "codes"),
    [
        (20, 0.72, []),
        (20, 0.78, ["one-class"]),
        (8, 0.83, []),
        (8, 0.87, ["one-class"]),
        (3, 1, []),
    ],
)
def test_a_class_that_takes_the_scan_unless_there_are_few(count, share, codes):
    labels = np.where(np.arange(1000) < 1000 * share, 1, 2).astype(np.uint8)
    unlabelled, space = np.zeros(5000, np.uint8), space_of(count)
    found = ScanSummary.of_labels(FILE, np.append(labels, unlabelled), space)
    assert [finding.code for finding in found.check.findings] == codes
    assert ScanSummary.of_labels(FILE, labels[:50], space).check.findings == ()


@given(st.permutations(range(6)))
def test_warnings_do_not_depend_on_the_order_of_the_scans(order):
    scans = []
    for number in range(6):
        codes = [
            code for place, code in enumerate(("tilted", "height", "of-3")) if number % 3 > place
        ]
        found = tuple(Finding(code, f"{code} of {number}", "turn it") for code in codes)
        file = ScanFile("08", f"{number}", Path("scan.bin"))
        scans.append(ScanSummary(file, ScanCheck(found)))
    summary = RunSummary(SMALL)
    for place in order:
        summary.add(scans[place])
    height, tilted = summary.warnings()
    assert (height["message"], height["scans"]) == ("height of 2", ["08/2", "08/5"])
    assert (tilted["message"], tilted["scans"]) == ("tilted of 1", ["08/1", "08/2", "08/4", "08/5"])
