# SPDX-License-Identifier: MIT
"""Fit of a network to the scans at hand: what their sensor does otherwise than that of training."""

import logging
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, SalsanextError, UsageError, counted
from salsanext_cli.fitting.scan_checks import check_scan
from salsanext_cli.fitting.view_fit import fit_ego, fit_view, view_text
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.network_input import (
    NO_INTENSITY,
    fills_rows,
    intensity_quantiles,
    row_gaps,
)
from salsanext_cli.geometry.projection import project
from salsanext_cli.records import Float, Scan
from salsanext_cli.results.layout import ScanFile, find_scans
from salsanext_cli.results.selection import evenly_spaced
from salsanext_cli.sensors.sensor import Sensor

log = logging.getLogger(__name__)

Scans = Sequence[ScanFile | Scan]
Result = TypeVar("Result")

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
    settings = NetworkSettings(fit=view, intensity=intensity)
    return fit_scans(settings, network, ScanSample(files, network.sensor))


class ScanSample:
    """Up to 16 scans of a source, evenly spaced; each is read and projected once for all fits.

    `files`: all scans of the source, whichever of them a run is about, so that runs over parts of
    it agree; unreadable ones do not count, since the run itself names them; `sensor`: tells how to
    read them; `image_of`: returns the range image of a scan, (5, H, W) float32, of those that were
    projected before.
    """

    def __init__(
        self,
        files: Scans,
        sensor: Sensor,
        image_of: Callable[[ScanFile], Float] | None = None,
    ) -> None:
        self.files, self.sensor, self.image_of = evenly_spaced(files, MAX_SCANS), sensor, image_of
        self._images: list[tuple[dict[str, Any], list[Float]]] = []

    @cached_property
    def scans(self) -> list[Scan]:
        """Scans that could be read; none if there are range images instead."""
        return [] if self.image_of else _usable(lambda file: _read(file, self.sensor), self.files)

    def images(self, sensor: Sensor) -> list[Float]:
        """Range images (5, H, W) float32, for a view, of the scans that would get labels."""
        view = sensor.view()
        for known, images in self._images:
            if known == view:
                return images
        if self.image_of:
            images = _usable(self.image_of, self.files)
        else:
            images = _usable(lambda scan: _checked_image(scan, sensor), self.scans)
        self._images = [(view, images)]
        return images


def _checked_image(scan: Scan, sensor: Sensor) -> Float:
    check_scan(Path(), scan, sensor)
    return project(scan, sensor).channels


def _usable(function: Callable[[Any], Result], items: Iterable[Any]) -> list[Result]:
    """Return the results of a function, but for the items that are no good."""
    results = []
    for item in items:
        with suppress(SalsanextError):
            results.append(function(item))
    return results


def fit_scans(
    settings: NetworkSettings, network: Network, sample: ScanSample, earlier: Sensor | None = None
) -> Network:
    """Return the network for the scans: view, intensity and gaps between the rows of their sensor.

    `network`: what the settings load; `earlier`: sensor of earlier results in the same folder; what
    was fitted then stays.
    """
    method, trained = _method(settings, network), network.card.sensor
    if sample.image_of is None:
        view = _fitted_view(sample, network.sensor, earlier, view=settings.fits_view)
        network = network.for_sensor(view)
    known = [sensor for sensor in (earlier, settings.named_sensor()) if sensor]
    quantiles: tuple[float, ...] = ()
    if method == "none":
        quantiles = NO_INTENSITY
    elif method:
        # Earlier results without intensity tell nothing about that of the scans; nor does the
        # sensor of the weights, which was named for its columns, say.
        others = ((), NO_INTENSITY, trained.intensity_quantiles)
        measured = (sensor.intensity_quantiles for sensor in known)
        usable = (found for found in measured if found not in others)
        quantiles = next(usable, ()) or intensity_quantiles(sample.images(network.sensor))
    gaps = None
    if trained.row_gaps is not None:
        others_gaps = (each.row_gaps for each in known)
        gaps = next((each for each in others_gaps if each not in (None, trained.row_gaps)), None)
        gaps = row_gaps(sample.images(network.sensor)) if gaps is None else gaps
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
    return _fitted_view(ScanSample(files, sensor), sensor, earlier, view=view)


def _fitted_view(
    sample: ScanSample, sensor: Sensor, earlier: Sensor | None, *, view: bool
) -> Sensor:
    sought = [name for name in EGO if getattr(sensor, name) is None]
    if not (view or sought):
        return sensor
    if earlier is not None:
        names = [*(FITTED if view else ()), *sought]
        return replace(sensor, **{name: getattr(earlier, name) for name in names})
    fitted = fit_view(sample.scans, sensor) if view else fit_ego(sample.scans, sensor)
    if replace(fitted, **{name: getattr(sensor, name) for name in EGO}) != sensor:
        scans = counted(len(sample.scans), "scan")
        log.log(NOTICE, "sensor fitted to %s: %s", scans, view_text(fitted))
    return fitted


def with_image_statistics(sensor: Sensor, images: Sequence[Float]) -> Sensor:
    """Return the sensor with what its range images, (5, H, W) each, say of intensity and gaps."""
    quantiles = intensity_quantiles(images)
    return replace(sensor, intensity_quantiles=quantiles, row_gaps=row_gaps(images))


def _method(settings: NetworkSettings, network: Network) -> str:
    """Return "match" or "none", or nothing where the intensity stays as it is."""
    method = settings.intensity
    if method not in INTENSITIES:
        raise UsageError("--intensity", method, ", ".join(INTENSITIES))
    if method == "raw" or network.card.sensor.intensity_quantiles:
        return {"raw": "", "auto": "match"}.get(method, method)
    if method == "auto":
        return ""
    found = f"{method}, but these weights do not know the intensity of their training"
    raise UsageError("--intensity", found, "auto or raw")


def _read(file: ScanFile | Scan, sensor: Sensor) -> Scan:
    return file if isinstance(file, Scan) else read_scan(file.path, sensor)
