# SPDX-License-Identifier: MIT
"""Sample of the scans of a source, to which a sensor is fitted."""

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.sensor_of_scan import member_of, origin_of_scan, sensor_of
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.recorded_origins import Origins
from salsanext_cli.runs.results.selection import evenly_spaced

Scans = Sequence[ScanFile | Scan]
OriginsOf = Callable[[Sequence[ScanFile], Sensor], Origins]
"""Function of scans and a fitted sensor that returns the origins that are known beforehand."""
Result = TypeVar("Result")

MAX_SCANS = 16  # Scans that a fit reads, evenly spaced among all of a source


class ScanSample:
    """Up to 16 scans of a source, evenly spaced, each of which is read once for all fits.

    They are a sample of all scans of the source, so that runs over parts of it agree. Unreadable
    scans are skipped, since the run reports them. `image_of` returns the range image (5, H, W) of a
    scan that was projected before. `origins_of` returns the origins of registered scans that the
    run uses; the others are found from the points.
    """

    def __init__(
        self,
        files: Scans,
        sensor: Sensor,
        image_of: Callable[[ScanFile], Float] | None = None,
        origins_of: OriginsOf | None = None,
    ) -> None:
        self.files = evenly_spaced(files, MAX_SCANS)
        self.sensor = sensor
        self.image_of = image_of
        self.origins_of = origins_of

    @cached_property
    def read(self) -> list[tuple[ScanFile | Scan, Scan]]:
        """Readable files, each with its scan."""
        return _usable(
            lambda f: (f, f if isinstance(f, Scan) else read_scan(f.path, self.sensor)), self.files
        )

    @property
    def scans(self) -> list[Scan]:
        """Readable scans; none if there are range images instead."""
        return [] if self.image_of else [scan for _, scan in self.read]

    def images(self, sensor: Sensor) -> list[Float]:
        """Return the range images (5, H, W) float32 for a sensor of the scans that pass checks."""
        return [image for images in self.images_of_members(sensor) for image in images]

    def images_of_members(self, sensor: Sensor) -> list[list[Float]]:
        """Return the images as of `images`, those of each member of a sensor by themselves.

        A scan belongs to the member that the run labels it with.
        """
        members: list[list[Float]] = [[] for _ in sensor.members]
        if self.image_of and not sensor.others:
            return [_usable(self.image_of, self.files)]
        origins = self._origins(sensor)

        def add_image(item: tuple[ScanFile | Scan, Scan]) -> None:
            file, scan = item
            origin = origin_of_scan(scan, sensor, origins.get(_name_of(file)))
            number = member_of(scan, sensor, origin)
            if self.image_of and isinstance(file, ScanFile):
                members[number].append(self.image_of(file))
                return
            placed = sensor_of(scan, sensor, origin)
            check_scan(Path(), scan, placed)
            members[number].append(project(scan, placed).channels)

        _usable(add_image, self.read)
        return members

    def members_of_scans(self, sensor: Sensor) -> list[int]:
        """Return the number of the member of a sensor that each readable scan belongs to."""
        origins = self._origins(sensor)
        return [
            member_of(scan, sensor, origin_of_scan(scan, sensor, origins.get(_name_of(file))))
            for file, scan in self.read
        ]

    def _origins(self, sensor: Sensor) -> Origins:
        """Return the origins of registered scans that the run uses, by name."""
        if self.origins_of is None or not sensor.has_registered:
            return {}
        return self.origins_of([file for file in self.files if isinstance(file, ScanFile)], sensor)


def _name_of(file: ScanFile | Scan) -> str:
    """Return the name of a file; empty for a scan in memory."""
    return file.name if isinstance(file, ScanFile) else ""


def _usable(function: Callable[[Any], Result], items: Iterable[Any]) -> list[Result]:
    """Return the results of a function for the items that it accepts."""
    results = []
    for item in items:
        with suppress(SalsanextError):
            results.append(function(item))
    return results
