# SPDX-License-Identifier: MIT
"""One scan as a network in training sees it, quick to draw: strips without words."""

from __future__ import annotations

from typing import BinaryIO

import numpy as np

from salsanext_cli.formats import read_scan
from salsanext_cli.formats.kitti import read_labels
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import Network
from salsanext_cli.report.canvas import stretched
from salsanext_cli.report.colours import Colours
from salsanext_cli.report.panel import range_strip
from salsanext_cli.report.range_image import error_picture, label_picture
from salsanext_cli.storage.layout import ScanFile

TALLER = 3
"""How many times a row is drawn, since beams are farther apart than columns."""
GAP = 6
"""White rows between strips."""


def draw_sample(out: BinaryIO, file: ScanFile, network: Network) -> Colours:
    """Draw range, truth, prediction and errors of a labelled scan below each other, as PNG.

    Parameters
    ----------
    out : BinaryIO
        An open file.
    file : ScanFile
        The scan.
    network : Network
        What predicts it, as `predict` does.

    Returns
    -------
    (4·3·H + gaps, W, 3) uint8
        The picture.
    """
    from matplotlib.image import imsave  # a second to import, and only this needs it

    space, sensor = network.card.space, network.sensor
    scan = read_scan(file.path, intensity_scale=sensor.intensity_scale)
    truth = space.to_train(read_labels(file.label_path, len(scan)), source=file.label_path)
    image = project(scan, sensor)
    pixel_labels = network.probabilities(image).argmax(axis=0)
    labels = knn_refine(image, pixel_labels, space.class_count)
    strips = [
        range_strip(image).picture,
        label_picture(image, truth, space),
        label_picture(image, labels, space),
        error_picture(image, truth, labels, space),
    ]
    gap = np.full((GAP, sensor.width, 3), 255, np.uint8)
    rows = [part for strip in strips for part in (gap, stretched(strip, TALLER, 1))][1:]
    picture = np.concatenate(rows)
    imsave(out, picture, format="png")
    return picture
