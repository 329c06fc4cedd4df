# SPDX-License-Identifier: MIT
"""Pictures of a scan and of all that is known about it."""

from __future__ import annotations

from pathlib import Path

from salsanext_cli.classes import LabelSpace, TrainIds
from salsanext_cli.geometry.projection import project
from salsanext_cli.report.birds_eye import View, birds_eye
from salsanext_cli.report.colours import error_colours, label_colours, legend_of
from salsanext_cli.report.panel import Strip, panel, range_strip, scalar_strip
from salsanext_cli.report.range_image import error_picture, label_picture
from salsanext_cli.sensors import Sensor
from salsanext_cli.storage.layout import ScanFile
from salsanext_cli.storage.scan_results import ScanResults, read_results


def draw_scan(
    file: ScanFile, out: Path, space: LabelSpace, sensor: Sensor, folder: Path
) -> tuple[Path, Path]:
    """Draw a scan as strips of its range image and from above.

    Parameters
    ----------
    file : ScanFile
        The scan.
    out : Path
        Holds what earlier stages left of it.
    space : LabelSpace
        What the labels mean.
    sensor : Sensor
        How to project it.
    folder : Path
        Where the two pictures go.

    Returns
    -------
    tuple of Path
        The strips and the view from above, both PNG.
    """
    cloud = read_results(file, out, sensor.intensity_scale)
    labels = _labels(cloud, space)
    name = f"{file.sequence}_{file.stem}"
    strips, above = folder / f"{name}_range.png", folder / f"{name}_above.png"
    wrong = len(labels) == 2
    legend = legend_of(space, *labels.values(), errors=wrong)
    panel(strips, _strips(cloud, labels, space, sensor), legend)
    views = [View(title, label_colours(ids, space)) for title, ids in labels.items()]
    if wrong:
        errors = error_colours(labels["truth"], labels["prediction"], space)
        views.append(View("errors", errors))
    birds_eye(above, cloud.scan.points, views, legend)
    return strips, above


def _labels(cloud: ScanResults, space: LabelSpace) -> dict[str, TrainIds]:
    """Return train ids by title, truth before prediction, as far as known."""
    known = {"truth": cloud.truth, "prediction": cloud.label}
    return {
        title: space.to_train(raw, strict=False) for title, raw in known.items() if raw is not None
    }


def _strips(
    cloud: ScanResults, labels: dict[str, TrainIds], space: LabelSpace, sensor: Sensor
) -> list[Strip]:
    image = project(cloud.scan, sensor)
    strips = [range_strip(image), scalar_strip(image, "intensity", image.channels[4])]
    strips += [Strip(title, label_picture(image, ids, space)) for title, ids in labels.items()]
    if len(labels) == 2:
        errors = error_picture(image, labels["truth"], labels["prediction"], space)
        strips.append(Strip("errors", errors))
    for kind, values in cloud.uncertainty.items():
        strips.append(scalar_strip(image, kind.replace("_", " "), values))
    return strips
