# SPDX-License-Identifier: MIT
"""Points whose labels are known to be right or wrong, with the features that may tell."""

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.engines.network import Network
from salsanext_cli.records import Float
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.training.tuning.labelled_images import read_labelled_image
from salsanext_cli.uncertainty.error_features import FEATURES, error_features
from salsanext_cli.uncertainty.monte_carlo import scan_seed

SEED = 0
"""Seed of the choice of points that are kept."""
MAX_POINTS = 1_000_000
"""Bound of the number of points of all scans, 37 MB."""
MAX_POINTS_OF_SCAN = 20_000
"""Points of one scan are much alike: more of them tell little."""

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPoints:
    """Features (M, F) of points of one scan whose labels are known to be wrong (M,) or right."""

    features: Float
    wrong: Mask

    @property
    def confidence(self) -> Float:
        """Probability of the label by the network's softmax, (M,) float32."""
        confidence: Float = self.features[:, FEATURES.index("probability of the label")]
        return confidence


def points_of_scan(scans: int) -> int:
    """Return how many points to keep of each of so many scans."""
    return max(1, min(MAX_POINTS_OF_SCAN, MAX_POINTS // scans))


def judged_points(file: ScanFile, network: Network, space: LabelSpace, most: int) -> JudgedPoints:
    """Predict a labelled scan as `predict` does, and judge a random sample of its points."""
    labelled = read_labelled_image(file, network, space)
    probabilities = network.probabilities(labelled.image, file.path)
    labels = network.labels(labelled.image, probabilities)
    features = error_features(labelled.image, probabilities, labels)
    random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
    count = len(labelled.truth)
    chosen = random.permutation(count)[:most]
    points = labelled.points[chosen]
    return JudgedPoints(features[points], labels[points] != labelled.truth[chosen])
