# SPDX-License-Identifier: MIT
"""Fit of a network to the scans at hand: what their sensor does otherwise than that of training."""

import logging
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cache
from pathlib import Path

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, SalsanextError, UsageError, counted
from salsanext_cli.fitting.ego_fit import fit_ego
from salsanext_cli.fitting.view_fit import fit_view, view_text
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.intensity import NO_INTENSITY, intensity_quantiles
from salsanext_cli.geometry.projection import project
from salsanext_cli.geometry.row_gaps import fills_rows, row_gaps
from salsanext_cli.records import Float, Scan
from salsanext_cli.results.layout import ScanFile, find_scans
from salsanext_cli.results.selection import evenly_spaced
from salsanext_cli.sensors.sensor import Sensor

log = logging.getLogger(__name__)

Scans = Sequence[ScanFile | Scan]

MAX_SCANS = 16
"""Scans that a fit reads, evenly spaced among all of a source."""
FITTED = ("name", "fov_up", "fov_down", "up", "origin")
"""Fields of a sensor that a fit of the view changes."""
EGO = ("min_range", "ego_box")
"""Fields that it finds unless they are told."""
INTENSITIES = ("auto", "match", "raw", "none")


def fit_network(
    network: Network,
    scans: Path | str | Sequence[Scan],
    *,
    view: bool = True,
    intensity: str = "auto",
) -> Network:
    """Return the network with view and intensity of its sensor fitted to scans, as `predict` does.

    Parameters
    ----------
    network : Network
    scans : Path, str or sequence of Scan
        A scan, a folder of scans, a sequence or a data set; or scans that were read. Up to 16 of
        them count, evenly spaced.
    view : bool
        Whether a view and a mounting that differ much from the sensor's are those of the scans;
        what the sensor does not tell of housing and vehicle is found either way.
    intensity : {"auto", "match", "raw", "none"}
        Whether the intensity is to be matched to that of training; "auto": if the weights know it.

    Raises
    ------
    NoInputError
        If there are no scans at the path.
    UsageError
        If there is no such way, or the weights do not know the intensity of their training.
    """
    files = find_scans(Path(scans)) if isinstance(scans, Path | str) else scans
    return fitted(NetworkSettings(fit=view, intensity=intensity), network, files)


def fitted(
    settings: NetworkSettings,
    network: Network,
    files: Scans,
    earlier: Sensor | None = None,
    image_of: Callable[[ScanFile], Float] | None = None,
) -> Network:
    """Return the network for the scans: view, intensity and gaps between the rows of their sensor.

    `network`: what they load; `files`: all scans of the source, whichever of them the run is about,
    so that runs over parts of it agree; unreadable ones do not count, since the run itself names
    them; `earlier`: of earlier results in the same folder; what was fitted then stays; `image_of`:
    returns the range image of a scan, (5, H, W) float32; otherwise it is read and projected.
    """
    how, trained = _method(settings, network), network.card.sensor
    given = network.sensor
    # They are read once, for the view as for the intensity and the gaps.
    scans = cache(lambda: files if image_of else list(sampled(files, given)))
    if image_of is None:
        found = _fitted_view(scans, given, earlier, view=settings.fits_view)
        network = network.for_sensor(found)
    known = [sensor for sensor in (earlier, settings.sensor) if sensor]
    images = cache(lambda: list(sampled_images(scans(), network.sensor, image_of)))
    quantiles: tuple[float, ...] = ()
    if how == "none":
        quantiles = NO_INTENSITY
    elif how:
        # Earlier results without intensity tell nothing about that of the scans; nor does the
        # sensor of the weights, which was named for its columns, say.
        others = ((), NO_INTENSITY, trained.intensity_quantiles)
        measured = (sensor.intensity_quantiles for sensor in known)
        usable = (found for found in measured if found not in others)
        quantiles = next(usable, ()) or intensity_quantiles(images())
    gaps = None
    if trained.row_gaps is not None:
        others_gaps = (each.row_gaps for each in known)
        gaps = next((each for each in others_gaps if each not in (None, trained.row_gaps)), None)
        gaps = row_gaps(images()) if gaps is None else gaps
    seen = replace(network.sensor, intensity_quantiles=quantiles, row_gaps=gaps)
    network = network.for_sensor(seen)
    if fills_rows(seen, trained):
        log.log(NOTICE, "gaps between rows, %.0f %% of their pixels, are filled", 100 * (gaps or 0))
    return network


def fitted_view(
    files: Scans, sensor: Sensor, earlier: Sensor | None = None, *, view: bool = True
) -> Sensor:
    """Return the sensor as `fit_view` fits it to scans, evenly spaced, and say so.

    Without `view`, only as `fit_ego` does. That of earlier results in the same folder stays.
    """
    return _fitted_view(lambda: list(sampled(files, sensor)), sensor, earlier, view=view)


def _fitted_view(
    read: Callable[[], Scans], sensor: Sensor, earlier: Sensor | None, *, view: bool
) -> Sensor:
    sought = [name for name in EGO if getattr(sensor, name) is None]
    if not (view or sought):
        return sensor
    if earlier is not None:
        names = [*(FITTED if view else ()), *sought]
        return replace(sensor, **{name: getattr(earlier, name) for name in names})
    scans = [scan for scan in read() if isinstance(scan, Scan)]
    found = fit_view(scans, sensor) if view else fit_ego(scans, sensor)
    if replace(found, **{name: getattr(sensor, name) for name in EGO}) != sensor:
        log.log(NOTICE, "sensor fitted to %s: %s", counted(len(scans), "scan"), view_text(found))
    return found


def with_image_statistics(sensor: Sensor, images: Sequence[Float]) -> Sensor:
    """Return the sensor with what its range images, (5, H, W) each, say of intensity and gaps."""
    quantiles = intensity_quantiles(images)
    return replace(sensor, intensity_quantiles=quantiles, row_gaps=row_gaps(images))


def _method(settings: NetworkSettings, network: Network) -> str:
    """Return "match" or "none", or nothing where the intensity stays as it is."""
    how = settings.intensity
    if how not in INTENSITIES:
        raise UsageError("--intensity", how, ", ".join(INTENSITIES))
    if how == "raw" or network.card.sensor.intensity_quantiles:
        return {"raw": "", "auto": "match"}.get(how, how)
    if how == "auto":
        return ""
    found = f"{how}, but these weights do not know the intensity of their training"
    raise UsageError("--intensity", found, "auto or raw")


def sampled_images(
    files: Scans,
    sensor: Sensor,
    image_of: Callable[[ScanFile], Float] | None = None,
) -> Iterator[Float]:
    """Yield the range images of scans, evenly spaced; parameters as of `fitted`."""
    for file in evenly_spaced(files, MAX_SCANS):
        with suppress(SalsanextError):
            if image_of is None or isinstance(file, Scan):
                yield project(_read(file, sensor), sensor).channels
            else:
                yield image_of(file)


def sampled(files: Scans, sensor: Sensor) -> Iterator[Scan]:
    """Yield scans, evenly spaced, but for those that cannot be read."""
    for file in evenly_spaced(files, MAX_SCANS):
        with suppress(SalsanextError):
            yield _read(file, sensor)


def _read(file: ScanFile | Scan, sensor: Sensor) -> Scan:
    return file if isinstance(file, Scan) else read_scan(file.path, sensor)
