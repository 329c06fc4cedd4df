# SPDX-License-Identifier: MIT
"""Novelty: distance of a pixel's features from those of the classes that the network knows."""

from salsanext_cli.errors import WeightsError
from salsanext_cli.inference.network import Network
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.uncertainty.scan_description import pixel_features


def novelty(network: Network, image: RangeImage) -> Float:
    """Return the distance of every pixel's features from the nearest known class.

    Parameters
    ----------
    network : Network
        With a novelty model.
    image : RangeImage
        One scan.

    Returns
    -------
    (H, W) float32
        Mahalanobis distance, at least 0; the mean square of a known class is the number of
        features, 32 in SalsaNext.

    Raises
    ------
    WeightsError
        If the weights have no novelty model.
    """
    model = network.card.novelty
    if model is None:
        remedy = "`salsanext tune novelty DATASET WEIGHTS_OUT` fits one to labelled scans"
        raise WeightsError(network.weights, "no novelty", "weights with a model of it", remedy)
    features = pixel_features(network, image)
    found: Float = model.distance(features.reshape(len(features), -1).T)
    return found.reshape(features.shape[1:])
