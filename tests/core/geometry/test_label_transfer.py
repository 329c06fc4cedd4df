# SPDX-License-Identifier: MIT
"""Transfer of labels by coordinates, compared with a loop over all pairs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.core.geometry.label_transfer import TOLERANCE_M, transfer_labels


def slow_transfer(points, cloud, labels):
    """Return the label of each point, None if it is missing, "several"; and the other points."""
    found = []
    for point in points:
        offsets = np.linalg.norm(cloud.astype(np.float64) - point.astype(np.float64), axis=1)
        near = (cloud == point).all(axis=1)
        if not near.any():
            near = offsets < TOLERANCE_M
        of_point = {int(label) for label in labels[near]}
        found.append(None if not of_point else "several" if len(of_point) > 1 else of_point.pop())
    finite = points[np.isfinite(points).all(axis=1)].astype(np.float64)
    others = [
        np.linalg.norm(finite - point, axis=1).min(initial=np.inf)
        for point in cloud.astype(np.float64)
        if np.isfinite(point).all()
    ]
    return found, [distance for distance in others if distance > TOLERANCE_M]


def as_listed(found):
    return [
        "several" if ambiguous else int(label) if known else None
        for label, known, ambiguous in zip(
            found.labels, found.has_label, found.ambiguous, strict=True
        )
    ]


@given(
    seed=st.integers(0, 1 << 30),
    count=st.integers(0, 60),
    size=st.sampled_from([0.002, 0.01, 5.0]),
    jitter=st.sampled_from([0.0, 0.0004]),
    share=st.sampled_from([0.0, 0.5, 1.0]),
)
def test_labels_equal_a_loop_over_all_pairs(seed, count, size, jitter, share):
    random = np.random.default_rng(seed)
    points = random.uniform(-size, size, (count, 3)).astype(np.float32)
    chosen = random.integers(0, max(count, 1), int(share * 2 * count))
    cloud = points[chosen] + random.uniform(-jitter, jitter, (len(chosen), 3)) * (
        random.random((len(chosen), 1)) < 0.5
    )
    cloud = np.concatenate([cloud, random.uniform(-9, 9, (3, 3))]).astype(np.float32)
    points[random.random(count) < 0.1] = np.nan
    cloud[random.random(len(cloud)) < 0.1, 1] = np.inf
    labels = random.integers(0, 3, len(cloud)).astype(np.uint32) * 40
    found = transfer_labels(points, cloud, labels)
    expected, others = slow_transfer(points, cloud, labels)
    assert as_listed(found) == expected
    assert found.missing.tolist() == [label is None for label in expected]
    np.testing.assert_allclose(sorted(found.unmatched), sorted(others), rtol=1e-5)
    assert found.cloud_points == np.isfinite(cloud).all(axis=1).sum()


def test_points_at_one_place_have_labels_of_their_own_in_a_cloud_of_the_same_order():
    points = np.float32([[1, 2, 3], [1, 2, 3], [np.nan, 0, 0], [4, 5, 6]])
    labels = np.array([10, 40, 50, 70], np.uint32)
    assert as_listed(transfer_labels(points, points, labels)) == [10, 40, 50, 70]
    rounded = points + np.float32([[0.0005, -0.0005, 0.0005]])
    assert as_listed(transfer_labels(points, rounded, labels)) == [10, 40, 50, 70]
    for order in ([3, 2, 1, 0], [0, 1, 3]):
        found = transfer_labels(points, points[order], labels[order])
        assert as_listed(found) == ["several", "several", None, 70]


def test_points_at_one_place_take_no_more_time_and_those_beyond_anything_are_far_away():
    """A sensor without returns gives tens of thousands of zeros, and billions of pairs."""
    points = np.zeros((60_000, 3), np.float32)
    found = transfer_labels(points, points[1:] - np.float32(1e-4), np.full(59_999, 9, np.uint32))
    assert (found.labels == 9).all()
    points = np.zeros((2, 3), np.float32)
    found = transfer_labels(points, points - np.float32([[3e38]]), np.ones(2, "u4"))
    assert found.missing.all()
    assert (found.unmatched > 1e38).all()
