# SPDX-License-Identifier: MIT
"""Transfer of labels between clouds of the same points, matched by coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Self

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.optional_packages import import_open3d
from salsanext_cli.core.records import Double, Float, Indices, Mask

TOLERANCE_M = 1e-3  # Largest distance of a copy; millimetres rounded per axis differ by 0.87
MAX_NEIGHBOURS = 16  # Nearest places around a point; no LiDAR resolves so many
NO_LOWEST = np.iinfo(np.int64).max  # Lowest label where there is none, above every label
NO_HIGHEST = -1  # Highest label where there is none, below every label

Labels = npt.NDArray[np.uint32]


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelTransfer:
    """Labels of N points, taken from a labelled cloud."""

    labels: Labels  # (N,) uint32: 0 where `has_label` is not set
    has_label: Mask  # (N,) bool: points that have a label of the cloud
    ambiguous: Mask  # (N,) bool: points at which the cloud has several labels
    # (U,) float64: distance of each point of the cloud that is a copy of none to the nearest point,
    # metres; infinite without any
    unmatched: Double
    cloud_points: int  # Number of cloud points with finite coordinates

    @classmethod
    def in_order(cls, labels: Labels) -> Self:
        """Return the labels (N,) uint32 of a cloud of the same points, in their order."""
        every = np.ones(len(labels), bool)
        return cls(
            labels=labels,
            has_label=every,
            ambiguous=~every,
            unmatched=np.empty(0),
            cloud_points=len(labels),
        )

    @property
    def missing(self) -> Mask:
        """Points without a copy in the cloud, (N,) bool."""
        return ~(self.has_label | self.ambiguous)

    def filled(self, label: int) -> Labels:
        """Return the labels (N,) uint32, with `label` for all points without one."""
        return np.where(self.has_label, self.labels, np.uint32(label))


def transfer_labels(points: Float, cloud: Float, labels: Labels) -> LabelTransfer:
    """Label each point as its copy in a cloud, whose points are in any order.

    In a cloud of the same points in the same order, the copy has the same number, so that points
    at one place may have different labels. Otherwise a copy has the same coordinates. Without one,
    all cloud points within `TOLERANCE_M` are copies. A point whose copies have different labels
    has none.

    Parameters
    ----------
    points : (N, 3) float32
        Points to label, in metres.
    cloud : (M, 3) float32
        Labelled points in the same frame, in metres.
    labels : (M,) uint32
        Labels of the cloud.

    Returns
    -------
    LabelTransfer
    """
    if _are_in_order(points, cloud):
        return LabelTransfer.in_order(labels)
    is_finite = np.isfinite(points).all(axis=1)
    finite_points = points[is_finite]
    in_cloud = np.isfinite(cloud).all(axis=1)
    cloud = cloud[in_cloud]
    labels = labels[in_cloud]
    places = _places(np.concatenate([cloud, finite_points]))
    place_of_cloud, place_of_point = np.split(places, [len(cloud)])
    count = places.max(initial=-1) + 1
    lowest = np.full(count, NO_LOWEST)
    highest = np.full(count, NO_HIGHEST, np.int64)
    np.minimum.at(lowest, place_of_cloud, labels)
    np.maximum.at(highest, place_of_cloud, labels)
    low = lowest[place_of_point]
    high = highest[place_of_point]
    has_no_copy = low > high
    # A search tree of thousands of equal points, such as the zeros of no return, is slow.
    cloud_places, first = np.unique(place_of_cloud, return_index=True)
    index = _nearby(finite_points[has_no_copy], cloud[first])
    lowest_nearby = np.where(index < 0, NO_LOWEST, lowest[cloud_places][index])
    highest_nearby = np.where(index < 0, NO_HIGHEST, highest[cloud_places][index])
    low[has_no_copy] = lowest_nearby.min(axis=1, initial=NO_LOWEST)
    high[has_no_copy] = highest_nearby.max(axis=1, initial=NO_HIGHEST)
    has_label = np.zeros(len(points), bool)
    has_label[is_finite] = low == high
    ambiguous = np.zeros(len(points), bool)
    ambiguous[is_finite] = low < high
    transferred = np.zeros(len(points), np.uint32)
    transferred[has_label] = low[low == high]
    point_places, first = np.unique(place_of_point, return_index=True)
    is_unused = ~np.isin(place_of_cloud, point_places)
    distances = _nearest(cloud[is_unused], finite_points[first])
    unmatched = distances[distances > TOLERANCE_M]
    return LabelTransfer(
        labels=transferred,
        has_label=has_label,
        ambiguous=ambiguous,
        unmatched=unmatched,
        cloud_points=len(cloud),
    )


def _are_in_order(points: Float, cloud: Float) -> bool:
    """Return whether each cloud point is a copy of the point with its number.

    Points without finite coordinates are copies of each other.
    """
    if len(points) != len(cloud):
        return False
    is_finite = np.isfinite(points).all(axis=1)
    if (np.isfinite(cloud).all(axis=1) != is_finite).any():
        return False
    offsets = cloud[is_finite].astype(np.float64) - points[is_finite]
    return bool((np.linalg.norm(offsets, axis=1) <= TOLERANCE_M).all())


def _places(points: Float) -> Indices:
    """Return a number for each point, (K,), the same for the same coordinates."""
    order = np.lexsort(points.T)
    differs = (points[order[1:]] != points[order[:-1]]).any(axis=1)
    places = np.empty(len(points), np.intp)
    places[order] = np.concatenate([np.zeros(min(1, len(points)), np.intp), np.cumsum(differs)])
    return places


def _nearby(points: Float, others: Float) -> npt.NDArray[np.int64]:
    """Return the indices of others within `TOLERANCE_M`, (K, `MAX_NEIGHBOURS`), padded by -1."""
    if not (len(points) and len(others)):
        return np.empty((len(points), 0), np.int64)
    search = _search(others)
    search.hybrid_index(TOLERANCE_M)
    results = search.hybrid_search(_tensor(points), TOLERANCE_M, MAX_NEIGHBOURS)
    return results[0].numpy()


def _nearest(points: Float, others: Float) -> Double:
    """Return the distance of each point to the nearest of others, (K,) float64 in metres."""
    if not (len(points) and len(others)):
        return np.full(len(points), np.inf)
    search = _search(others)
    search.knn_index()
    squared: Double = search.knn_search(_tensor(points), 1)[1].numpy()[:, 0]
    return np.sqrt(squared)


def _search(points: Float) -> Any:
    """Return a search of open3d for the nearest of points (K, 3)."""
    return import_open3d().core.nns.NearestNeighborSearch(_tensor(points))


def _tensor(points: Float) -> Any:
    """Return points as a tensor of open3d."""
    return import_open3d().core.Tensor(points.astype(np.float64))
