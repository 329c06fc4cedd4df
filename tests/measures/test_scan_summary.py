# SPDX-License-Identifier: MIT
from collections import Counter

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from scans import SMALL

from salsanext_cli import label_space
from salsanext_cli.geometry.coverage import FieldOfViewCoverage
from salsanext_cli.measures.scan_summary import NOT_COUNTED, RunSummary, ScanSummary

SPACE = label_space()
SCANS = st.lists(st.lists(st.integers(0, SPACE.class_count - 1), max_size=30), max_size=5)


@given(SCANS)
@settings(max_examples=50, deadline=None)
def test_the_largest_classes_are_those_counted_slowly(scans):
    summary = RunSummary(SMALL, SPACE)
    for train_ids in scans:
        labels = np.array(train_ids, np.uint8)
        summary.add(ScanSummary.of_labels(labels, SPACE.class_count, NOT_COUNTED))
    counts = Counter(SPACE.names[i] for train_ids in scans for i in train_ids)
    found = summary.largest_classes()
    assert all(share == counts[name] / counts.total() for name, share in found.items())
    largest = [count / counts.total() for _, count in counts.most_common(5)]
    assert list(found.values()) == largest


def test_scans_of_pixels_have_no_classes():
    summary = RunSummary(SMALL)
    summary.add(ScanSummary())
    assert summary.finish().largest_classes() == {}


def test_coverage_is_checked(caplog):
    summary = RunSummary(SMALL)
    summary.add(ScanSummary(FieldOfViewCoverage(10, 5)))
    assert not caplog.text
    summary.finish()
    assert "50 % of the points of 1 scan lie outside" in caplog.text
