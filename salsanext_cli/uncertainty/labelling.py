# SPDX-License-Identifier: MIT
"""Labels of the points of a scan from the softmax of its pixels, and results beside them."""

from dataclasses import dataclass

import numpy as np

from salsanext_cli.classes.label_space import TrainIds
from salsanext_cli.engines.network import Network
from salsanext_cli.geometry.gather import points_from_pixels
from salsanext_cli.geometry.knn import KnnParameters, knn_refine
from salsanext_cli.records import Float, RangeImage
from salsanext_cli.results.layout import ERROR, ScanFile
from salsanext_cli.results.output_run import OutputRun
from salsanext_cli.uncertainty.error_features import label_error


@dataclass(frozen=True, slots=True)
class Labelling:
    """Way from the softmax of a scan to the results that are asked for."""

    knn: KnnParameters  # Neighbours in the kNN refinement
    output: OutputRun  # Takes the results
    reject: float | None  # Points whose error is above it are unlabelled

    def write(
        self, file: ScanFile, image: RangeImage, probabilities: Float, network: Network
    ) -> tuple[TrainIds, int]:
        """Write the results, the labels last.

        `probabilities` (C, H, W) float32, softmax of every pixel; `network`: what computed it.

        Returns (N,) uint8, the labels; number of points unlabelled for their error.
        """
        space, pixel_labels, output = network.space, most_probable(probabilities), self.output
        labels = knn_refine(image, pixel_labels, space.class_count, self.knn, network.device)
        rejected = np.zeros(len(labels), bool)
        if "pixel_labels" in output.folders:
            output.write_array(file, "pixel_labels", pixel_labels)
        if "probabilities" in output.folders:
            none = np.eye(1, space.class_count)  # certainly unlabelled
            of_points = points_from_pixels(probabilities, image.pixel_of_point, none)
            output.write_array(file, "probabilities", of_points.astype(np.float16))
        if ERROR in output.folders:
            error = label_error(network, image, probabilities, labels)
            output.write_array(file, ERROR, error)
            if self.reject is not None:
                rejected = error > self.reject
        labels[rejected] = 0
        output.write_labels(file, space.to_raw(labels))
        return labels, int(rejected.sum())


def most_probable(probabilities: Float) -> TrainIds:
    """Return the most probable class of every pixel: (C, H, W) to (H, W) uint8."""
    labels: TrainIds = probabilities.argmax(axis=0).astype(np.uint8)
    return labels
