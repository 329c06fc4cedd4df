# SPDX-License-Identifier: MIT
"""Sample of the scans of a source, to which a sensor is fitted."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from typing import Any, Protocol, TypeVar

from salsanext_cli.core.checks.scan_checks import check_scan
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.geometry.projection import project
from salsanext_cli.core.geometry.sensor_of_scan import member_of, origin_of_scan, sensor_of
from salsanext_cli.core.records import Float, Origins, Scan
from salsanext_cli.core.sensors.sensor import Sensor

Result = TypeVar("Result")


class ScanSource(Protocol):
    """Scan that a fit reads when it needs its points."""

    @property
    def name(self) -> str:
        """Name of the scan in messages and among origins."""

    def read(self) -> Scan:
        """Return the scan in the frame of its file."""

    def image(self) -> Float:
        """Return the range image (5, H, W) float32 of a scan that was projected before."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ScanInMemory:
    """Scan that needs no reading, and was not projected before."""

    name: str
    scan: Scan

    def read(self) -> Scan:
        """Return the scan."""
        return self.scan

    def image(self) -> Float:
        """Refuse: there is no range image."""
        raise NotImplementedError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SampledScan:
    """Scan of a sample that was read."""

    source: ScanSource
    scan: Scan


class ScanSample:
    """A few scans of a source, each of which is read at most once for all fits.

    Unreadable scans are skipped, since the run reports them.

    Parameters
    ----------
    sources : sequence of ScanSource
        Scans of the sample.
    has_images : bool
        Whether the scans were projected before; then their images are not computed again.
    origins_of : callable, optional
        Returns the origins of registered scans that are known beforehand, for a fitted sensor. The
        others are found from the points.
    """

    def __init__(
        self,
        sources: Sequence[ScanSource],
        *,
        has_images: bool = False,
        origins_of: Callable[[Sensor], Origins] | None = None,
    ) -> None:
        self.sources = sources
        self.has_images = has_images
        self.origins_of = origins_of

    @classmethod
    def from_scans(cls, scans: Sequence[Scan]) -> ScanSample:
        """Return a sample of scans in memory."""
        sources = [
            ScanInMemory(name=f"scan {number}", scan=scan) for number, scan in enumerate(scans)
        ]
        return cls(sources)

    @cached_property
    def read(self) -> list[SampledScan]:
        """Readable scans with their sources."""
        return _usable(lambda source: SampledScan(source=source, scan=source.read()), self.sources)

    @property
    def scans(self) -> list[Scan]:
        """Readable scans; none if there are range images instead."""
        return [] if self.has_images else [sampled.scan for sampled in self.read]

    def subset(self, places: Sequence[int]) -> ScanSample:
        """Return the sample of the readable scans at these places, without another reading."""
        sampled = [self.read[place] for place in places]
        sample = ScanSample([item.source for item in sampled])
        sample.read = sampled
        return sample

    def images(self, sensor: Sensor) -> list[Float]:
        """Return the range images (5, H, W) float32 for a sensor of the scans that pass checks."""
        return [image for images in self.images_of_members(sensor) for image in images]

    def images_of_members(self, sensor: Sensor) -> list[list[Float]]:
        """Return the images as of `images`, those of each member of a sensor by themselves.

        A scan belongs to the member that the run labels it with.
        """
        if self.has_images and not sensor.others:
            return [_usable(lambda source: source.image(), self.sources)]
        members: list[list[Float]] = [[] for _ in sensor.members]
        origins = self._origins(sensor)

        def add_image(sampled: SampledScan) -> None:
            scan = sampled.scan
            origin = origin_of_scan(scan, sensor, origins.get(sampled.source.name))
            number = member_of(scan, sensor, origin)
            if self.has_images:
                members[number].append(sampled.source.image())
                return
            placed = sensor_of(scan, sensor, origin)
            check_scan(sampled.source.name, scan, placed)
            members[number].append(project(scan, placed).channels)

        _usable(add_image, self.read)
        return members

    def members_of_scans(self, sensor: Sensor) -> list[int]:
        """Return the number of the member of a sensor that each readable scan belongs to."""
        origins = self._origins(sensor)
        numbers = []
        for sampled in self.read:
            origin = origin_of_scan(sampled.scan, sensor, origins.get(sampled.source.name))
            numbers.append(member_of(sampled.scan, sensor, origin))
        return numbers

    def _origins(self, sensor: Sensor) -> Origins:
        """Return the origins of registered scans that are known beforehand, by name."""
        if self.origins_of is None or not sensor.has_registered:
            return {}
        return self.origins_of(sensor)


def _usable(function: Callable[[Any], Result], items: Iterable[Any]) -> list[Result]:
    """Return the results of a function for the items that it accepts."""
    results = []
    for item in items:
        with suppress(SalsanextError):
            results.append(function(item))
    return results
