# SPDX-License-Identifier: MIT
"""Range images that `project` wrote into an output folder, and their sensor."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.records import CHANNELS, Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.wording import argument
from salsanext_cli.io.formats.npy import read_array
from salsanext_cli.runs.results.manifest import Manifest
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.results.setting_differences import differences
from salsanext_cli.runs.scans.scan_file import ScanFile


def range_image(file: ScanFile, folder: Path, sensor: Sensor) -> Float:
    """Read the range image (5, H, W) float32 that `project` wrote of a scan."""
    path = output_path(folder, file.sequence, "range", file.stem)
    return read_array(path, "float32", (len(CHANNELS), sensor.height, sensor.width))


def projected_sensor(folder: Path) -> Sensor | None:
    """Return the sensor of the range images in an output folder, None without any."""
    projected = Manifest(folder).settings("project")
    return projected.sensor if projected else None


def sensor_of_images(folder: Path, projected: Sensor | None, fitted: Sensor) -> Sensor:
    """Return the sensor of a network for projected scans; refuse another geometry than theirs."""
    if projected is None:
        raise UsageError(folder, "has no range images", "the output folder of `project`")
    fits = [
        replace(member, columns=projected.columns, intensity_field=projected.intensity_field)
        for member in fitted.members
    ]
    images = [replace(other, means=fitted.means, stds=fitted.stds) for other in projected.members]
    changed = _change(images, fits)
    if changed:
        size = f"{projected.height}×{projected.width}"
        problem = f"has range images of {projected.name}, {size}: {changed}"
        expected = f"the sensor of the weights or of {argument('sensor')}"
        hint = f"project again, or pass {argument('sensor', 'width')} of `project`"
        raise UsageError(folder, problem, expected, hint)
    return replace(fits[0], others=tuple(fits[1:]))


def _change(projected: Sequence[Sensor], fitted: Sequence[Sensor]) -> str:
    """Return how the number or the geometry of fitted sensors differs, "" if it does not."""
    if len(projected) != len(fitted):
        return differences({"sensors": len(projected)}, {"sensors": len(fitted)})
    for before, now in zip(projected, fitted, strict=True):
        changed = differences(before.view(), now.view())
        if changed:
            return changed
    return ""
