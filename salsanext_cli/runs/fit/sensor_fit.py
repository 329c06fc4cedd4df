# SPDX-License-Identifier: MIT
"""Fit of a network to scans of another sensor than that of its training."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import fields, replace
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import NOTICE, UsageError, counted
from salsanext_cli.core.fitting.field_of_view import MIN_SCANS, fit_ego, fit_view, view_text
from salsanext_cli.core.fitting.sensor_groups import SensorGroup, sensor_groups
from salsanext_cli.core.geometry.network_input import (
    NO_INTENSITY,
    column_gaps,
    fills_rows,
    intensity_quantiles,
    row_gaps,
)
from salsanext_cli.core.plain_data import as_json
from salsanext_cli.core.records import Float, Scan
from salsanext_cli.core.sensors.sensor import FIELD_OF_VIEW, FittedView, Sensor
from salsanext_cli.runs.fit.scan_sample import OriginsOf, Scans, ScanSample
from salsanext_cli.runs.network_settings import NetworkSettings
from salsanext_cli.runs.results.manifest import Manifest, StageSettings
from salsanext_cli.runs.results.paths import ScanFile, find_scans

log = logging.getLogger(__name__)

VIEW_TOLERANCES = {"fov_up": 5.0, "fov_down": 5.0, "up": 0.1, "origin": 0.5}
"""Largest differences, in degrees, of a unit vector, in metres, of fits to scans of one sensor."""
MAX_COLUMN_GAPS = 0.3
"""Largest share of gaps between columns: sensors of 1 800 columns had up to 0.22 in images of 2 048
columns, sensors of 1 024 and 1 088 columns 0.42 to 0.49."""
EGO = ("min_range", "ego_box")  # Fields that are always fitted where they are None
INTENSITIES = ("auto", "match", "raw", "none")


def fit_network(
    network: Network,
    scans: Path | str | Sequence[Scan],
    *,
    view: bool = True,
    intensity: str = "auto",
) -> Network:
    """Return the network with its sensor fitted to scans, as `predict` does.

    Parameters
    ----------
    network : Network
        Network with the sensor of its weights.
    scans : Path, str or sequence of Scan
        A scan, a folder of scans, a sequence or a data set, or scans in memory. The fit reads up
        to 16 of them, evenly spaced.
    view : bool
        Whether to fit the field of view and the mounting; unknown bounds of housing and vehicle are
        always fitted.
    intensity : {"auto", "match", "raw", "none"}
        Whether to match the intensity to that of training; "auto" does if the weights state it.

    Returns
    -------
    Network
        Network for the sensor of the scans.

    Raises
    ------
    NoInputError
        If there are no scans at the path.
    UsageError
        If `intensity` is another word, or the weights do not state the intensity of training.
    """
    files = find_scans(Path(scans)) if isinstance(scans, Path | str) else scans
    settings = NetworkSettings(fit=view, intensity=intensity)
    return fit_scans(settings, network, ScanSample(files, network.sensor))


def resolved_for(
    settings: NetworkSettings, network: Network, scans: Sequence[ScanFile]
) -> NetworkSettings:
    """Return settings with which each worker loads the network; announce it if it computes.

    It computes nothing if the only scan cannot be read.
    """
    fails = len(scans) == 1 and not ScanSample(scans, network.sensor).read
    return settings.resolved(network, silent=fails)


def fit_scans(
    settings: NetworkSettings, network: Network, sample: ScanSample, earlier: Sensor | None = None
) -> Network:
    """Return a loaded network fitted to scans; the fit for `earlier` results stays.

    Images of the default width become narrower if the sensor has fewer columns.
    """
    fitted = network.for_sensor(_fit_of_network(settings, network, sample, earlier))
    width = _width_of_columns(settings, fitted, sample)
    if width == fitted.sensor.width:
        return fitted
    network = network.at_width(width)
    return network.for_sensor(_fit_of_network(settings, network, sample, earlier))


def _width_of_columns(settings: NetworkSettings, fitted: Network, sample: ScanSample) -> int:
    """Return the largest width of training at most that of a fitted network with few gaps.

    A width that was named stays; then the log says which width would have few gaps.
    """
    wide, trained = fitted.sensor.width, fitted.card.trained_widths
    widths = sorted((width for width in trained if width < wide), reverse=True)
    if not widths or not settings.fits_view or sample.image_of:
        return wide
    shares = {
        width: column_gaps(sample.images(fitted.sensor.resized(width=width))) or 0.0
        for width in (wide, *widths)
    }
    suited = next((w for w, share in shares.items() if share <= MAX_COLUMN_GAPS), widths[-1])
    if suited == wide:
        return wide
    text = "%.0f %% of the pixels between columns of the sensor are empty in images of %d columns"
    log.log(NOTICE, text, 100 * shares[wide], wide)
    if settings.width is not None or wide != trained[0]:
        log.log(NOTICE, "omit --width, or use --width %d", suited)
        return wide
    return suited


def _fit_of_network(
    settings: NetworkSettings, network: Network, sample: ScanSample, earlier: Sensor | None
) -> Sensor:
    """Return the sensor of a network, fitted to the view and then to the images of scans."""
    sensor = network.sensor
    if sample.image_of is None:
        fit = partial(_fitted_view, view=settings.fits_view, mounting=settings.fits_mounting)
        sensor = _by_sensor(fit, sample, sensor, earlier)
    elif sensor.others:
        _announce_members(sample, sensor)
    images_of_members = cache(lambda: sample.images_of_members(sensor))
    members = []
    for number, member in enumerate(sensor.members):
        before = earlier.members[number] if earlier and earlier.others else earlier
        images = partial(_images_of_member, images_of_members, number)
        members.append(_with_statistics(settings, network, member, before, images))
    return _joined(members)


def _announce_members(sample: ScanSample, sensor: Sensor) -> None:
    """Log the scans of each of several sensors."""
    numbers = sample.members_of_scans(sensor)
    for number in range(len(sensor.members)):
        files = [sample.read[place][0] for place, other in enumerate(numbers) if other == number]
        _announce_member(number, len(sensor.members), files)


def _images_of_member(
    images_of_members: Callable[[], list[list[Float]]], number: int
) -> list[Float]:
    """Return the images of the scans of one member."""
    return images_of_members()[number]


def _with_statistics(
    settings: NetworkSettings,
    network: Network,
    sensor: Sensor,
    earlier: Sensor | None,
    images: Callable[[], list[Float]],
) -> Sensor:
    """Return a member with the intensity and the gaps of its images, for a network."""
    method = _method(settings, network)
    trained = network.card.sensor
    references = [other for other in (earlier, settings.named_sensor()) if other]
    quantiles: tuple[float, ...] = ()
    if method == "none":
        quantiles = NO_INTENSITY
    elif method:
        # Neither earlier results without intensity nor the sensor of the weights, which was named
        # for its columns, show the intensity of the scans.
        others = ((), NO_INTENSITY, trained.intensity_quantiles)
        stated = [s.intensity_quantiles for s in references if s.intensity_quantiles not in others]
        quantiles = stated[0] if stated else intensity_quantiles(images())
    gaps = None
    if trained.row_gaps is not None:
        shares = [s.row_gaps for s in references if s.row_gaps not in (None, trained.row_gaps)]
        gaps = shares[0] if shares else row_gaps(images())
    fitted = replace(sensor, intensity_quantiles=quantiles, row_gaps=gaps)
    if fills_rows(fitted, trained):
        share = 100 * (gaps or 0)
        problem = (
            "%.0f %% of the image is empty between the rows of the sensor; filled for the network"
        )
        log.log(NOTICE, problem, share)
    return fitted


Fit = Callable[[ScanSample, Sensor, Sensor | None], Sensor]
"""Function that fits a sensor to a sample of its scans, with the fit for earlier results."""


def _by_sensor(fit: Fit, sample: ScanSample, sensor: Sensor, earlier: Sensor | None) -> Sensor:
    """Return the fit to the scans of the most frequent sensor, with the fits to the others."""
    before = earlier if earlier and earlier.others else sensor
    if not before.others and (earlier or len(sample.files) < 2):
        return fit(sample, sensor, earlier)
    if before.others:  # Sensors of earlier results or of range images
        numbers = sample.members_of_scans(before)
        groups = [
            SensorGroup(tuple(i for i, n in enumerate(numbers) if n == number), member.traits)
            for number, member in enumerate(before.members)
        ]
    else:
        groups = sensor_groups(sample.scans, sensor)
    if len(groups) < 2:
        return fit(sample, sensor, earlier)
    fits = []
    for number, group in enumerate(groups):
        files = [sample.read[place][0] for place in group.numbers]
        _announce_member(number, len(groups), files)
        part = ScanSample(files, sample.sensor)
        member = sensor.members[number] if sensor.others else sensor
        of_earlier = earlier.members[number] if earlier and earlier.others else earlier
        fits.append(replace(fit(part, member, of_earlier), traits=group.traits))
    return replace(fits[0], others=tuple(fits[1:]))


def _announce_member(number: int, count: int, files: Scans) -> None:
    """Log the scans of one of several sensors."""
    if files:
        scans = counted(len(files), "scan")
        name = getattr(files[0], "name", "none")
        log.log(NOTICE, "sensor %d of %d: %s, such as %s", number + 1, count, scans, name)


def _joined(members: Sequence[Sensor]) -> Sensor:
    """Return the sensor of all members, a single one if the fits to them are alike."""
    if len({replace(member, traits=(), others=()) for member in members}) == 1:
        return replace(members[0], traits=(), others=())
    return replace(members[0], others=tuple(members[1:]))


def fitted_view(
    scans: Scans,
    sensor: Sensor,
    earlier: Sensor | None = None,
    *,
    view: bool = True,
    mounting: bool = True,
) -> Sensor:
    """Return the sensor fitted to a sample of scans by `fit_view`, and log the fit.

    Without `view`, `fit_ego` fits it; without `mounting`, that of the sensor stays. The fit for
    `earlier` results in the same folder stays.
    """
    fit = partial(_fitted_view, view=view, mounting=mounting)
    return _joined(_by_sensor(fit, ScanSample(scans, sensor), sensor, earlier).members)


def _fitted_view(
    sample: ScanSample, sensor: Sensor, earlier: Sensor | None, *, view: bool, mounting: bool
) -> Sensor:
    """Do what `fitted_view` does for the scans of one sensor."""
    unknown = [name for name in EGO if getattr(sensor, name) is None]
    if not (view or unknown):
        return sensor
    if earlier is not None:
        of_view: tuple[str, ...] = FIELD_OF_VIEW
        if mounting:
            of_view = (*(field.name for field in fields(FittedView)), "registered")
        names = [*(of_view if view else ()), *unknown]
        return replace(sensor, **{name: getattr(earlier, name) for name in names})
    scans = sample.scans
    fitted = fit_view(scans, sensor, mounting=mounting) if view else fit_ego(scans, sensor)
    if replace(fitted, **{name: getattr(sensor, name) for name in EGO}) != sensor:
        count = counted(len(scans), "scan")
        log.log(NOTICE, "sensor fitted to %s: %s", count, view_text(fitted))
    if sensor.ego_box is None and 0 < len(scans) < MIN_SCANS and not fitted.registered:
        count = counted(len(scans), "scan")
        text = (
            "own vehicle not searched for in %s: that needs %d of one drive, or --ego with its box"
        )
        log.log(NOTICE, text, count, MIN_SCANS)
    return fitted


def with_image_statistics(sensor: Sensor, images: Sequence[Float]) -> Sensor:
    """Return the sensor with the intensity and the gaps of its range images, (5, H, W) each."""
    quantiles = intensity_quantiles(images)
    return replace(sensor, intensity_quantiles=quantiles, row_gaps=row_gaps(images))


def _method(settings: NetworkSettings, network: Network) -> str:
    """Return "match" or "none", or an empty text if the intensity stays."""
    method, is_known = settings.intensity, bool(network.card.sensor.intensity_quantiles)
    if method not in INTENSITIES:
        raise UsageError("--intensity", f"{method!r} is not possible", ", ".join(INTENSITIES))
    if method in ("match", "none") and not is_known:
        problem = f"{method!r}, but the weights do not state the intensity of training"
        raise UsageError("--intensity", problem, "auto or raw")
    if method == "raw" or not is_known:
        return ""
    return "none" if method == "none" else "match"


def labels_depend_on(settings: NetworkSettings, network: Network) -> dict[str, object]:
    """Return, by option, the settings that labels depend on besides weights and scans."""
    view = (settings.named_sensor() or network.card.sensor).view() | {"fit": settings.fits_view}
    options = {
        "--min-range": view.pop("min_range", None),
        "--ego": view.pop("ego_box", None),
        "--intensity": _method(settings, network),
        "--precision": network.backend.precision,
        "--width": view.pop("width"),
        "--sensor": {key: value for key, value in view.items() if key != "columns"},
    }
    return dict(as_json(options))


def as_typed(option: str, value: Any) -> str:
    """Return a value of `labels_depend_on` as it is typed for its option."""
    if option == "--ego" and not value:
        return "auto" if value is None else "none"
    if option == "--ego":
        return ",".join(f"{number:g}" for number in value)
    if option == "--intensity":
        return str(value or "raw")
    if value is None:
        return "the default"
    return f"{value:g}" if isinstance(value, float) else str(value)


def is_other_view(view: FittedView, sensor: Sensor) -> bool:
    """Return whether a sensor differs from a fitted one by more than `VIEW_TOLERANCES`."""
    other = FittedView.of(sensor)
    return other.name != view.name or any(
        np.abs(np.subtract(getattr(other, name), getattr(view, name))).max() > tolerance
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
    origins_of: OriginsOf | None = None,
) -> Network:
    """Return a network fitted to the scans of a run, or as for earlier results in its folder.

    `image_of`, `origins_of`: range images and origins of the scans, as of `ScanSample`.
    """
    recorded = [] if overwrite else map(Manifest(out).settings, ("predict", "uncertainty"))
    earlier = next((s for s in recorded if s and s.weights == network.backend.sha256), None)
    sample = ScanSample(files, network.sensor, image_of, origins_of)
    return fit_scans(settings, network, sample, earlier.sensor if earlier else None)


def settings_of_network(network: Network) -> StageSettings:
    """Return the settings of a network that the results of a stage depend on."""
    backend, card = network.backend, network.card
    return StageSettings(
        weights=backend.sha256,
        weights_version=card.version,
        inherited="; ".join(filter(None, (card.inherited(), card.of_other_width()))) or None,
        label_space=network.space,
        sensor=network.sensor.without_noise(),
        precision=backend.precision,
        engine=backend.library,
        trained_on="".join(sorted(card.trained_on)) or None,
    )
