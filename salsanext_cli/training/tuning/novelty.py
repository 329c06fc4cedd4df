# SPDX-License-Identifier: MIT
"""Fit of a novelty model: means of the features by class, and their covariance within classes."""

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes import TrainIds
from salsanext_cli.network.novelty_model import NoveltyModel
from salsanext_cli.records import Float

MIN_POINTS = 200
"""Fewest points of a class that has a mean of its own."""
RIDGE = 1e-4
"""Share of the mean variance that is added to all, so that constant features do no harm."""

Double = npt.NDArray[np.float64]


class ClassMoments:
    """Running sums of the features of each class, float64."""

    def __init__(self, class_count: int) -> None:
        self.counts = np.zeros(class_count, np.int64)
        self.sums: Double = np.zeros((class_count, 0))
        self.squares: Double = np.zeros((class_count, 0, 0))

    def add(self, features: Float, truth: TrainIds) -> None:
        """Count points: their features (M, D) and train ids (M,)."""
        if not self.sums.size:
            size, count = features.shape[1], len(self.counts)
            self.sums, self.squares = np.zeros((count, size)), np.zeros((count, size, size))
        for place in np.unique(truth):
            own = features[truth == place].astype(np.float64)
            self.counts[place] += len(own)
            self.sums[place] += own.sum(axis=0)
            self.squares[place] += own.T @ own

    def model(self) -> NoveltyModel | None:
        """Return the model of the classes of enough points; None if there is no such class."""
        known = np.flatnonzero(self.counts >= MIN_POINTS)
        if not len(known):
            return None
        counts = self.counts[known, None]
        means = self.sums[known] / counts
        scatter = self.squares[known].sum(axis=0) - (means * counts).T @ means
        covariance = scatter / counts.sum()
        size = len(covariance)
        covariance += max(RIDGE * np.trace(covariance) / size, 1e-12) * np.eye(size)
        whitening = np.linalg.inv(np.linalg.cholesky(covariance))
        return NoveltyModel(whitening.astype(np.float32), (means @ whitening.T).astype(np.float32))
