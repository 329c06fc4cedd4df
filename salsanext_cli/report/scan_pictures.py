# SPDX-License-Identifier: MIT
"""Pictures of a scan with its labels and results, and of a prediction during training."""

from pathlib import Path
from typing import BinaryIO

import numpy as np

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.formats import read_scan
from salsanext_cli.formats.labels import read_labels
from salsanext_cli.geometry.knn import knn_refine
from salsanext_cli.geometry.projection import project
from salsanext_cli.inference.network import Network
from salsanext_cli.report.birds_eye import birds_eye
from salsanext_cli.report.colours import Colours, error_colours, legend_of
from salsanext_cli.report.panel import coloured_strip, panel, range_strip, scalar_strip
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.scan_results import read_results

ROW_HEIGHT_PX = 3
"""Height of a row of `draw_sample`; beams are farther apart than columns."""
GAP_PX = 6
"""White rows between its strips."""


def draw_scan(
    file: ScanFile, out: Path, space: LabelSpace, sensor: Sensor, folder: Path
) -> tuple[Path, Path]:
    """Draw a scan as strips of its range image and from above.

    Parameters
    ----------
    file : ScanFile
        The scan.
    out : Path
        Output folder with results of earlier stages.
    space : LabelSpace
        Meaning of the labels.
    sensor : Sensor
        Sensor of the range image.
    folder : Path
        Folder of the two pictures.

    Returns
    -------
    tuple of Path
        The strips and the view from above, both PNG.
    """
    found = read_results(file, out, sensor)
    known = {"truth": found.truth, "prediction": found.label}
    labels = {k: space.to_train(raw, strict=False) for k, raw in known.items() if raw is not None}
    legend = legend_of(space, *labels.values(), errors=len(labels) == 2)
    image = project(found.scan, sensor)
    colours = _colours(labels, space)
    strips = [range_strip(image), scalar_strip(image, "intensity", image.channels[4])]
    strips += [coloured_strip(image, *each) for each in colours.items()]
    for kind, values in found.uncertainty.items():
        title = "probability of error" if kind == "error" else kind.replace("_", " ")
        strips.append(scalar_strip(image, title, values))
    name = f"{file.sequence}_{file.stem}"
    range_path, above_path = folder / f"{name}_range.png", folder / f"{name}_above.png"
    panel(range_path, strips, legend)
    birds_eye(above_path, found.scan.points, colours, legend)
    return range_path, above_path


def draw_sample(out: BinaryIO, file: ScanFile, network: Network) -> Colours:
    """Draw range, truth, prediction and errors of a labelled scan below each other, as PNG.

    It is quick to draw: strips without text.

    Parameters
    ----------
    out : BinaryIO
        An open file.
    file : ScanFile
        The scan.
    network : Network
        Network to predict it with, as `predict` does.

    Returns
    -------
    (4·3·H + gaps, W, 3) uint8
        The picture.
    """
    from matplotlib.image import imsave  # a second to import, and only this needs it

    space, sensor = network.space, network.sensor
    scan = read_scan(file.path, sensor)
    truth = space.to_train(read_labels(file.label_path, len(scan)), source=file.label_path)
    image = project(scan, sensor)
    pixel_labels = network.probabilities(image).argmax(axis=0)
    labels = knn_refine(image, pixel_labels, space.class_count)
    colours = _colours({"truth": truth, "prediction": labels}, space)
    strips = [range_strip(image), *(coloured_strip(image, *each) for each in colours.items())]
    gap = np.full((GAP_PX, sensor.width, 3), 255, np.uint8)
    rows = [part for s in strips for part in (gap, s.picture.repeat(ROW_HEIGHT_PX, axis=0))][1:]
    picture = np.concatenate(rows)
    imsave(out, picture, format="png")
    return picture


def _colours(labels: dict[str, TrainIds], space: LabelSpace) -> dict[str, Colours]:
    """Return the colours of points by title, and of the errors of a prediction with its truth."""
    colours: dict[str, Colours] = {title: space.colours[ids] for title, ids in labels.items()}
    if len(labels) == 2:
        colours["errors"] = error_colours(labels["truth"], labels["prediction"], space)
    return colours
