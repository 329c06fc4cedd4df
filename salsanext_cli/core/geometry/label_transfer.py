# SPDX-License-Identifier: MIT
"""Transfer of labels between clouds of the same points, matched by coordinates."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.optional_packages import import_open3d
from salsanext_cli.core.records import Double, Float, Indices, Mask

TOLERANCE_M = 1e-3  # Largest distance of a copy; millimetres rounded per axis differ by 0.87
MAX_NEIGHBOURS = 16  # Nearest places around a point; no LiDAR resolves so many
NOTHING = np.iinfo(np.int64).max  # Lowest of no labels; the highest is -1, below it

Labels = npt.NDArray[np.uint32]


@dataclass(frozen=True, slots=True)
class LabelTransfer:
    """Labels of N points, taken from a labelled cloud."""

    labels: Labels  # (N,) uint32: 0 where `known` is not set
    known: Mask  # (N,) bool: points that have a label of the cloud
    ambiguous: Mask  # (N,) bool: points at which the cloud has several labels
    # (U,) float64: distance of each point of the cloud that is a copy of none to the nearest point,
    # metres; infinite without any
    unmatched: Double
    cloud_points: int  # Number of cloud points with finite coordinates

    @property
    def missing(self) -> Mask:
        """Points without a copy in the cloud, (N,) bool."""
        return ~(self.known | self.ambiguous)

    def filled(self, label: int) -> Labels:
        """Return the labels (N,) uint32, with `label` for all points without one."""
        return np.where(self.known, self.labels, np.uint32(label))


def transfer_labels(points: Float, cloud: Float, labels: Labels) -> LabelTransfer:
    """Label each point (N, 3) as its copy in a cloud (M, 3) with labels (M,), in any order.

    A copy has the same coordinates. Without one, all cloud points within `TOLERANCE_M` are copies.
    A point whose copies have different labels has none.
    """
    finite = np.isfinite(points).all(axis=1)
    of_cloud = np.isfinite(cloud).all(axis=1)
    cloud, labels = cloud[of_cloud], labels[of_cloud]
    wanted = points[finite]
    places = _places(np.concatenate([cloud, wanted]))
    place_of_cloud, place = np.split(places, [len(cloud)])
    count = places.max(initial=-1) + 1
    lowest, highest = np.full(count, NOTHING), np.full(count, -1, np.int64)
    np.minimum.at(lowest, place_of_cloud, labels)
    np.maximum.at(highest, place_of_cloud, labels)
    low, high = lowest[place], highest[place]
    alone = low > high
    # A search tree of thousands of equal points, such as the zeros of no return, is slow.
    used, first = np.unique(place_of_cloud, return_index=True)
    index = _nearby(wanted[alone], cloud[first])
    low[alone] = np.where(index < 0, NOTHING, lowest[used][index]).min(axis=1, initial=NOTHING)
    high[alone] = np.where(index < 0, -1, highest[used][index]).max(axis=1, initial=-1)
    of_points, first = np.unique(place, return_index=True)
    distances = _nearest(cloud[~np.isin(place_of_cloud, of_points)], wanted[first])
    transferred = np.zeros(len(points), np.uint32)
    known, ambiguous = np.zeros((2, len(points)), bool)
    known[finite], ambiguous[finite] = low == high, low < high
    transferred[known] = low[low == high]
    unmatched = distances[distances > TOLERANCE_M]
    return LabelTransfer(transferred, known, ambiguous, unmatched, len(cloud))


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
    index, *_ = search.hybrid_search(_tensor(points), TOLERANCE_M, MAX_NEIGHBOURS)
    return index.numpy()


def _nearest(points: Float, others: Float) -> Double:
    """Return the distance of each point to the nearest of others, (K,) float64 in metres."""
    if not (len(points) and len(others)):
        return np.full(len(points), np.inf)
    search = _search(others)
    search.knn_index()
    squared: Double = search.knn_search(_tensor(points), 1)[1].numpy()[:, 0]
    return np.sqrt(squared)


def _search(points: Float) -> Any:
    return import_open3d().core.nns.NearestNeighborSearch(_tensor(points))


def _tensor(points: Float) -> Any:
    return import_open3d().core.Tensor(points.astype(np.float64))
