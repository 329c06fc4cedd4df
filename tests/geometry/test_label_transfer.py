# SPDX-License-Identifier: MIT
"""Transfer of labels by coordinates, compared with a loop over all pairs."""

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from salsanext_cli.geometry.label_transfer import TOLERANCE_M, merged_transfers, transfer_labels


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
        for label, known, ambiguous in zip(found.labels, found.known, found.ambiguous, strict=True)
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


def slow_merge(points, clouds, unlabelled):
    """Return the label of each point by a loop over all places of all clouds."""

    def copies(cloud, point):
        same = (cloud == point).all(axis=1)
        return same, np.linalg.norm(cloud.astype("f8") - point, axis=1) < TOLERANCE_M

    rounded = []
    for cloud, _ in clouds:
        found = [copies(cloud, point) for point in points]
        exact = sum(bool(same.any()) for same, _ in found)
        rounded.append(exact < sum(bool(near.any() and not same.any()) for same, near in found))
    merged = []
    for point in points:
        found = [copies(cloud, point) for cloud, _ in clouds]
        others = any(same.any() for same, _ in found)
        labels = []
        for (same, near), (_, own), moved in zip(found, clouds, rounded, strict=True):
            used = same if same.any() else near if moved or not others else np.zeros_like(near)
            labels.append({*own[used].tolist()})
        given = {label for each in labels for label in each if label & 0xFFFF != unlabelled}
        classes = {label & 0xFFFF for label in given}
        numbers = {label >> 16 for label in given if label >> 16}
        if any(len(each) > 1 for each in labels) or len(classes) > 1:
            merged.append("several")
        elif classes:
            merged.append(classes.pop() | (numbers.pop() << 16 if len(numbers) == 1 else 0))
        else:
            merged.append(unlabelled if any(labels) else None)
    return merged


@given(
    seed=st.integers(0, 1 << 30),
    size=st.sampled_from([0.002, 0.01]),
    count=st.integers(1, 4),
    unlabelled=st.sampled_from([0, 255]),
)
def test_merged_clouds_equal_a_loop_over_all_pairs(seed, size, count, unlabelled):
    random = np.random.default_rng(seed)
    points = random.uniform(-size, size, (40, 3)).astype(np.float32)
    points[random.random(40) < 0.1] = np.nan
    clouds = []
    for _ in range(count):
        cloud = points[random.integers(0, 40, 25)]
        moved = random.random((25, 1)) < random.choice([0.4, 1.0])
        cloud = cloud + (moved * random.uniform(-4e-4, 4e-4, cloud.shape)).astype(np.float32)
        labels = random.choice([unlabelled, 10, 10, 10, 40, 10 | 1 << 16, 10 | 2 << 16], 25).astype(
            np.uint32
        )
        clouds.append((cloud, labels))
    parts = [transfer_labels(points, *each) for each in clouds]
    found = merged_transfers(parts, unlabelled)
    assert as_listed(found) == slow_merge(points, clouds, unlabelled)
    assert (found.labels[~found.known] == 0).all()
    assert found.cloud_points == sum(part.cloud_points for part in parts)
    assert len(found.unmatched) == sum(len(part.unmatched) for part in parts)


def test_equal_points_are_fast_and_huge_coordinates_are_far_away():
    """A sensor without returns gives tens of thousands of zeros, and billions of pairs."""
    points = np.zeros((60_000, 3), np.float32)
    found = transfer_labels(points, points - np.float32(1e-4), np.full(60_000, 9, np.uint32))
    assert (found.labels == 9).all()
    points = np.zeros((2, 3), np.float32)
    found = transfer_labels(points, points - np.float32([[3e38]]), np.ones(2, "u4"))
    assert found.missing.all()
    assert (found.unmatched > 1e38).all()
