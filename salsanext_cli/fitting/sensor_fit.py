# SPDX-License-Identifier: MIT
"""Network of a run, fitted to its scans: what their sensor does otherwise than that of training."""

import logging
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import fields, replace
from functools import cached_property, partial
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from salsanext_cli.engines.network import Network
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import NOTICE, SalsanextError, UsageError, counted
from salsanext_cli.files.json_files import as_json
from salsanext_cli.fitting.field_of_view import fit_ego, fit_view, view_text
from salsanext_cli.fitting.scan_checks import check_scan
from salsanext_cli.formats import read_scan
from salsanext_cli.geometry.network_input import (
    NO_INTENSITY,
    fills_rows,
    intensity_quantiles,
    row_gaps,
)
from salsanext_cli.geometry.projection import project
from salsanext_cli.geometry.scan_traits import kinds_of, sensor_of
from salsanext_cli.records import Float, Scan
from salsanext_cli.results.manifest import Manifest
from salsanext_cli.results.paths import ScanFile, find_scans
from salsanext_cli.results.selection import evenly_spaced
from salsanext_cli.results.settings import StageSettings
from salsanext_cli.sensors.sensor import FittedView, Sensor

log = logging.getLogger(__name__)

Scans = Sequence[ScanFile | Scan]
Result = TypeVar("Result")

MAX_SCANS = 16  # Scans that a fit reads, evenly spaced among all of a source
VIEW_TOLERANCES = {"fov_up": 5.0, "fov_down": 5.0, "up": 0.1, "origin": 0.5}
"""Largest differences, in degrees, of a unit vector, in metres, of fits to scans of one sensor."""
EGO = ("min_range", "ego_box")  # Fields that it finds unless they are told
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

    They are of all scans of the source, whichever of them a run is about, so that runs over parts
    of it agree; unreadable ones do not count, since the run itself names them. `image_of` returns
    the range image (5, H, W) of a scan, of those that were projected before.
    """

    def __init__(
        self, files: Scans, sensor: Sensor, image_of: Callable[[ScanFile], Float] | None = None
    ) -> None:
        self.files, self.sensor, self.image_of = evenly_spaced(files, MAX_SCANS), sensor, image_of
        self._view: object = None
        self._images: list[Float] = []

    @cached_property
    def read(self) -> list[tuple[ScanFile | Scan, Scan]]:
        """Files that could be read, each with its scan."""
        return _usable(self._read, self.files)

    @property
    def scans(self) -> list[Scan]:
        """Scans that could be read; none if there are range images instead."""
        return [] if self.image_of else [scan for _, scan in self.read]

    def _read(self, file: ScanFile | Scan) -> tuple[ScanFile | Scan, Scan]:
        return file, file if isinstance(file, Scan) else read_scan(file.path, self.sensor)

    def images(self, sensor: Sensor) -> list[Float]:
        """Range images (5, H, W) float32, for a view, of the scans that would get labels."""
        if (view := sensor.view()) != self._view:
            if self.image_of:
                self._images = _usable(self.image_of, self.files)
            else:
                self._images = _usable(lambda scan: _checked_image(scan, sensor), self.scans)
            self._view = view
        return self._images


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
    """Return the network, as loaded, for the scans; what was fitted for `earlier` results stays."""

    def fit(part: ScanSample, sensor: Sensor, before: Sensor | None) -> Sensor:
        return _fit_of_network(settings, network.for_sensor(sensor), part, before)

    return network.for_sensor(_by_sensor(fit, sample, network.sensor, earlier))


def _fit_of_network(
    settings: NetworkSettings, network: Network, sample: ScanSample, earlier: Sensor | None
) -> Sensor:
    """Return the sensor of a network with what is fitted to scans of one sensor."""
    method, trained, sensor = _method(settings, network), network.card.sensor, network.sensor
    if sample.image_of is None:
        sensor = _fitted_view(sample, sensor, earlier, view=settings.fits_view)
    known = [each for each in (earlier, settings.named_sensor()) if each]
    quantiles: tuple[float, ...] = ()
    if method == "none":
        quantiles = NO_INTENSITY
    elif method:
        # Earlier results without intensity tell nothing about that of the scans; nor does the
        # sensor of the weights, which was named for its columns, say.
        others = ((), NO_INTENSITY, trained.intensity_quantiles)
        told = [
            each.intensity_quantiles for each in known if each.intensity_quantiles not in others
        ]
        quantiles = told[0] if told else intensity_quantiles(sample.images(sensor))
    gaps = None
    if trained.row_gaps is not None:
        shares = [each.row_gaps for each in known if each.row_gaps not in (None, trained.row_gaps)]
        gaps = shares[0] if shares else row_gaps(sample.images(sensor))
    seen = replace(sensor, intensity_quantiles=quantiles, row_gaps=gaps)
    if fills_rows(seen, trained):
        log.log(NOTICE, "gaps between rows, %.0f %% of their pixels, are filled", 100 * (gaps or 0))
    return seen


Fit = Callable[[ScanSample, Sensor, Sensor | None], Sensor]
"""Fits a sensor to a sample of its scans; what was fitted for earlier results stays."""


def _by_sensor(fit: Fit, sample: ScanSample, sensor: Sensor, earlier: Sensor | None) -> Sensor:
    """Return the sensor that is fitted to the scans of most, with the others, each to its own."""
    known = earlier if earlier and earlier.others else sensor
    if not known.others and (earlier or sample.image_of or len(sample.files) < 2):
        return fit(sample, sensor, earlier)
    if known.others:  # Those of earlier results, or of range images
        usual = [each.traits for each in known.members]
        kinds = [known.members.index(sensor_of(scan, known)) for _, scan in sample.read]
    else:
        kinds, usual = kinds_of([scan for _, scan in sample.read])
    if len(usual) < 2:
        return fit(sample, sensor, earlier)
    fits = []
    for kind, of_kind in enumerate(usual):
        files = [file for (file, _), each in zip(sample.read, kinds, strict=True) if each == kind]
        if files:
            scans, name = counted(len(files), "scan"), getattr(files[0], "name", "none")
            log.log(NOTICE, "sensor %d of %d: %s, such as %s", kind + 1, len(usual), scans, name)
        part = ScanSample(files, sample.sensor, sample.image_of)
        own = sensor.members[kind] if sensor.others else sensor
        before = earlier.members[kind] if earlier and earlier.others else earlier
        fits.append(replace(fit(part, own, before), traits=of_kind))
    alike = len({replace(each, traits=()) for each in fits}) == 1
    return replace(fits[0], traits=()) if alike else replace(fits[0], others=tuple(fits[1:]))


def fitted_view(
    scans: Scans, sensor: Sensor, earlier: Sensor | None = None, *, view: bool = True
) -> Sensor:
    """Return the sensor as `fit_view` fits it to scans, evenly spaced, and say so.

    Without `view`, only as `fit_ego` does. That of earlier results in the same folder stays.
    """
    return _by_sensor(partial(_fitted_view, view=view), ScanSample(scans, sensor), sensor, earlier)


def _fitted_view(
    sample: ScanSample, sensor: Sensor, earlier: Sensor | None, *, view: bool
) -> Sensor:
    """Do what `fitted_view` does for the scans of one sensor."""
    sought = [name for name in EGO if getattr(sensor, name) is None]
    if not (view or sought):
        return sensor
    if earlier is not None:
        names = [*((f.name for f in fields(FittedView)) if view else ()), *sought]
        return replace(sensor, **{name: getattr(earlier, name) for name in names})
    fitted = fit_view(sample.scans, sensor) if view else fit_ego(sample.scans, sensor)
    if replace(fitted, **{name: getattr(sensor, name) for name in EGO}) != sensor:
        count = counted(len(sample.scans), "scan")
        log.log(NOTICE, "sensor fitted to %s: %s", count, view_text(fitted))
    return fitted


def with_image_statistics(sensor: Sensor, images: Sequence[Float]) -> Sensor:
    """Return the sensor with what its range images, (5, H, W) each, say of intensity and gaps."""
    quantiles = intensity_quantiles(images)
    return replace(sensor, intensity_quantiles=quantiles, row_gaps=row_gaps(images))


def _method(settings: NetworkSettings, network: Network) -> str:
    """Return "match" or "none", or nothing where the intensity stays as it is."""
    method, known = settings.intensity, bool(network.card.sensor.intensity_quantiles)
    if method not in INTENSITIES:
        raise UsageError("--intensity", method, ", ".join(INTENSITIES))
    if method in ("match", "none") and not known:
        found = f"{method}, but these weights do not know the intensity of their training"
        raise UsageError("--intensity", found, "auto or raw")
    if method == "raw" or not known:
        return ""
    return "none" if method == "none" else "match"


def labels_depend_on(settings: NetworkSettings, network: Network) -> dict[str, object]:
    """Return by option what labels depend on besides weights and scans, before any fit."""
    view = (settings.named_sensor() or network.card.sensor).view() | {"fit": settings.fits_view}
    asked = {
        "--min-range": view.pop("min_range", None),
        "--ego": view.pop("ego_box", None),
        "--intensity": _method(settings, network),
        "--precision": network.backend.precision,
        "--sensor": {key: value for key, value in view.items() if key != "columns"},
    }
    return dict(as_json(asked))


def is_other_view(view: FittedView, sensor: Sensor) -> bool:
    """Return whether a sensor is fitted otherwise than a view, or far away from it."""
    own = FittedView.of(sensor)
    return own.name != view.name or any(
        np.abs(np.subtract(getattr(own, name), getattr(view, name))).max() > tolerance
        for name, tolerance in VIEW_TOLERANCES.items()
    )


def network_of_run(
    settings: NetworkSettings,
    network: Network,
    files: Sequence[ScanFile],
    out: Path,
    *,
    overwrite: bool = False,
    image_of: Callable[[ScanFile], Float] | None = None,
) -> Network:
    """Return a network fitted to a run's scans, as earlier results in its folder were made."""
    made = [] if overwrite else map(Manifest(out).settings, ("predict", "uncertainty"))
    earlier = next((s for s in made if s and s.weights == network.backend.sha256), None)
    sample = ScanSample(files, network.sensor, image_of)
    return fit_scans(settings, network, sample, earlier.sensor if earlier else None)


def settings_of_network(network: Network) -> StageSettings:
    """Return what the results of a stage depend on of the network that computes them."""
    backend, card = network.backend, network.card
    return StageSettings(
        weights=backend.sha256,
        weights_version=card.version,
        inherited=card.inherited() or None,
        label_space=network.space,
        sensor=network.sensor.without_noise(),
        precision=backend.precision,
        engine=backend.library,
        trained_on="".join(sorted(card.trained_on)) or None,
    )
