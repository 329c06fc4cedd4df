# SPDX-License-Identifier: MIT
"""Picture of a prediction during training."""

from typing import BinaryIO

import numpy as np

from salsanext_cli.engines.network import Network
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.geometry.projection import project
from salsanext_cli.report.colours import Colours, error_colours, screen_colours
from salsanext_cli.report.panel import coloured_strip, range_strip
from salsanext_cli.results.layout import ScanFile

ROW_HEIGHT_PX = 3
"""Height of a row of `draw_sample`; beams are farther apart than columns."""
GAP_PX = 6
"""White rows between its strips."""


def draw_sample(out: BinaryIO, file: ScanFile, network: Network) -> Colours:
    """Draw range, truth, prediction and errors of a labelled scan below each other, as PNG.

    It is quick to draw: strips without text.

    `out`: an open file; `file`: the scan; `network`: network to predict it with, as `predict` does.

    Returns (4·3·H + gaps, W, 3) uint8, the picture.
    """
    from matplotlib.image import imsave  # a second to import, and only this needs it

    space, sensor = network.space, network.sensor
    scan = read_scan(file.path, sensor)
    truth = space.to_train(read_labels(file.label_path, len(scan)), source=file.label_path)
    image = project(scan, sensor)
    labels = network.labels(image, network.probabilities(image))
    of_classes = screen_colours(space)
    colours: dict[str, Colours] = {"truth": of_classes[truth], "prediction": of_classes[labels]}
    colours["errors"] = error_colours(truth, labels, space)
    strips = [range_strip(image), *(coloured_strip(image, *each) for each in colours.items())]
    gap = np.full((GAP_PX, sensor.width, 3), 255, np.uint8)
    rows = [part for s in strips for part in (gap, s.picture.repeat(ROW_HEIGHT_PX, axis=0))][1:]
    picture = np.concatenate(rows)
    imsave(out, picture, format="png")
    return picture
