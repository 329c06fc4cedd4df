# SPDX-License-Identifier: MIT
"""Sample of the files of a source, to which a sensor is fitted."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.records import Float, Origins, Scan
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import evenly_spaced

ImageOf = Callable[[ScanFile], Float]
"""Function that returns the range image (5, H, W) float32 of a scan that was projected before."""
OriginsOf = Callable[[Sequence[ScanFile], Sensor], Origins]
"""Function of scans and a fitted sensor that returns the origins that are known beforehand."""

MAX_SCANS = 16  # Scans that a fit reads, evenly spaced among all of a source


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FileSource:
    """Scan of a file, as a `ScanSource`."""

    file: ScanFile
    sensor: Sensor  # Names the columns of the file
    image_of: ImageOf | None = None

    @property
    def name(self) -> str:
        """Name of the scan."""
        return self.file.name

    def read(self) -> Scan:
        """Read the scan."""
        return read_scan(self.file.path, self.sensor)

    def image(self) -> Float:
        """Return the range image (5, H, W) of the scan."""
        if self.image_of is None:
            raise NotImplementedError
        return self.image_of(self.file)


def sample_of_files(
    files: Sequence[ScanFile],
    sensor: Sensor,
    image_of: ImageOf | None = None,
    origins_of: OriginsOf | None = None,
) -> ScanSample:
    """Return up to 16 scans of a source, evenly spaced.

    They are a sample of all scans of the source, so that runs over parts of it agree.

    Parameters
    ----------
    files : sequence of ScanFile
        All scans of the source.
    sensor : Sensor
        Sensor that names the columns of the files.
    image_of : callable, optional
        Returns the range image of a scan that was projected before.
    origins_of : callable, optional
        Returns the origins of registered scans that the run uses; points show the others.

    Returns
    -------
    ScanSample
    """
    chosen = evenly_spaced(files, MAX_SCANS)
    sources = [FileSource(file=file, sensor=sensor, image_of=image_of) for file in chosen]

    def origins_of_sample(sensor: Sensor) -> Origins:
        return {} if origins_of is None else origins_of(chosen, sensor)

    return ScanSample(sources, has_images=image_of is not None, origins_of=origins_of_sample)
