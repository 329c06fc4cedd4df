# SPDX-License-Identifier: MIT
"""Range images that `project` wrote, as input of a network."""

from dataclasses import replace
from pathlib import Path

from salsanext_cli.errors import UsageError, shortened
from salsanext_cli.formats.npy import read_array
from salsanext_cli.records import CHANNELS, Float
from salsanext_cli.results.layout import ScanFile, output_path
from salsanext_cli.results.stage_records import stage_settings
from salsanext_cli.sensors.sensor import Sensor


def range_image(file: ScanFile, folder: Path, sensor: Sensor) -> tuple[Path, Float]:
    """Read what `project` wrote of a scan; return the file and its content, (5, H, W) float32."""
    path = output_path(folder, file.sequence, "range", file.stem)
    return path, read_array(path, "float32", (len(CHANNELS), sensor.height, sensor.width))


def projected_sensor(folder: Path) -> Sensor | None:
    """Return the sensor of the range images in an output folder, None if it holds none."""
    settings = stage_settings(folder, "project")
    if settings is None:
        return None
    return Sensor.from_dict(settings.table("sensor"), settings.path)


def sensor_of_images(folder: Path, projected: Sensor | None, wanted: Sensor) -> Sensor:
    """Return the network's sensor with the columns of the scans; refuse another geometry.

    Normalisation is the network's own.
    """
    if projected is None:
        raise UsageError(folder, "holds no range images", "the output folder of `project`")
    wanted = replace(wanted, columns=projected.columns)
    normalised = replace(projected, means=wanted.means, stds=wanted.stds)
    theirs, ours = normalised.view(), wanted.view()
    if other := sorted(key for key in theirs.keys() | ours if theirs.get(key) != ours.get(key)):
        found, expected = (
            ", ".join(f"{key} {shortened(view.get(key))}" for key in other)
            for view in (theirs, ours)
        )
        raise UsageError(
            folder,
            f"range images of {projected.name}, {projected.height}×{projected.width}: {found}",
            f"{expected}, as the weights or --sensor say",
            "project again, or give the sensor that was projected with",
        )
    return wanted
