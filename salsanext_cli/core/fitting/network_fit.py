# SPDX-License-Identifier: MIT
"""Fit of a network to scans of another sensor than that of its training.

`view_fit` fits the field of view, the mounting and the vehicle by the points of the scans; this
module fits the intensity, the gaps and the width of their range images then. Without a network,
`view_fit` fits a sensor alone, and `field_of_view` fits the sequences of a training.
"""

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.fitting.scan_sample import ScanSample
from salsanext_cli.core.fitting.view_fit import announce_member, fit_views, joined
from salsanext_cli.core.geometry.intensity import NO_INTENSITY, intensity_quantiles
from salsanext_cli.core.geometry.row_gaps import column_gaps, fills_rows, row_gaps
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float
from salsanext_cli.core.sensors.sensor import Sensor
from salsanext_cli.core.texts import percentage, with_hint
from salsanext_cli.core.wording import argument, setting

log = logging.getLogger(__name__)

MAX_COLUMN_GAPS = 0.3
"""Largest share of gaps between columns: sensors of 1 800 columns had up to 0.22 in images of 2 048
columns, sensors of 1 024 and 1 088 columns 0.42 to 0.49."""
INTENSITIES = ("auto", "match", "raw", "none")


@dataclass(frozen=True, slots=True, kw_only=True)
class FitSettings:
    """What a fit of a network to scans may change.

    Attributes
    ----------
    view, mounting : bool
        Whether to fit the field of view, and with it the mounting; unknown bounds of housing and
        vehicle are always fitted.
    intensity : {"auto", "match", "raw", "none"}
        Whether to match the intensity to that of training; "auto" does if the weights state it.
    named : Sensor, optional
        Requested sensor, whose intensity and gaps stay if it states them.
    is_width_named : bool
        Whether the width of the images was requested, so that it stays.
    """

    view: bool = True
    mounting: bool = True
    intensity: str = "auto"
    named: Sensor | None = None
    is_width_named: bool = False


def fit_to_sample(
    network: Network, sample: ScanSample, settings: FitSettings, earlier: Sensor | None = None
) -> Network:
    """Return a network with its sensor fitted to scans.

    Images of the default width become narrower if the sensor has fewer columns.

    Parameters
    ----------
    network : Network
        Network with the sensor of its weights, or another one to start from.
    sample : ScanSample
        Scans that the fit reads, if it needs any.
    settings : FitSettings
        What the fit may change.
    earlier : Sensor, optional
        Fit for earlier results in the same folder, which stays.

    Returns
    -------
    Network

    Raises
    ------
    UsageError
        If `settings.intensity` is another word, or the weights do not state that of training.
    """
    viewed = _with_views(network.sensor, sample, settings, earlier)

    @cache
    def images_at(width: int) -> list[list[Float]]:
        return sample.images_of_members(viewed.resized(width=width))

    width = _width_of_columns(network, sample, settings, images_at)
    if width != viewed.width:
        network = network.at_width(width)
    members = []
    for number, member in enumerate(viewed.resized(width=width).members):
        before = earlier.members[number] if earlier and earlier.others else earlier

        def images(number: int = number) -> list[Float]:
            return images_at(width)[number]

        members.append(_with_statistics(network, settings, member, before, images))
    return network.for_sensor(joined(members))


def _with_views(
    sensor: Sensor, sample: ScanSample, settings: FitSettings, earlier: Sensor | None
) -> Sensor:
    """Return a sensor fitted to the views of scans, unless they were projected before."""
    if not sample.has_images:
        return fit_views(sample, sensor, earlier, view=settings.view, mounting=settings.mounting)
    if sensor.others:
        _announce_members(sample, sensor)
    return sensor


def _announce_members(sample: ScanSample, sensor: Sensor) -> None:
    """Log the scans of each of several sensors."""
    numbers = sample.members_of_scans(sensor)
    for number in range(len(sensor.members)):
        places = [place for place, other in enumerate(numbers) if other == number]
        announce_member(sample, places, number, len(sensor.members))


def _with_statistics(
    network: Network,
    settings: FitSettings,
    sensor: Sensor,
    earlier: Sensor | None,
    images: Callable[[], list[Float]],
) -> Sensor:
    """Return a member with the intensity and the gaps of its images, for a network."""
    method = intensity_method(settings.intensity, network)
    trained = network.card.sensor
    references = [other for other in (earlier, settings.named) if other]
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


def intensity_method(intensity: str, network: Network) -> str:
    """Return "match" or "none" for a word of `INTENSITIES`, empty text if the intensity stays."""
    is_known = bool(network.card.sensor.intensity_quantiles)
    if intensity not in INTENSITIES:
        methods = ", ".join(INTENSITIES)
        raise UsageError(argument("intensity"), f"{intensity!r} is not possible", methods)
    if intensity in ("match", "none") and not is_known:
        problem = f"{intensity!r}, but the weights do not state the intensity of training"
        raise UsageError(argument("intensity"), problem, "auto or raw")
    if intensity == "raw" or not is_known:
        return ""
    return "none" if intensity == "none" else "match"


def _width_of_columns(
    network: Network,
    sample: ScanSample,
    settings: FitSettings,
    images_at: Callable[[int], list[list[Float]]],
) -> int:
    """Return the largest width of training at most that of a network with few gaps.

    A width that was named stays; then the log says which width would have few gaps.

    Parameters
    ----------
    network : Network
        Network before its fit.
    sample : ScanSample
        Scans of the fit.
    settings : FitSettings
        What the fit may change.
    images_at : callable
        Returns the range images (5, H, W) of each member of the fitted sensor for a width.

    Returns
    -------
    int
        Number of columns.
    """
    wide = network.sensor.width
    trained = network.card.trained_widths
    widths = sorted((width for width in trained if width < wide), reverse=True)
    if not widths or not settings.view or sample.has_images:
        return wide

    @cache
    def gaps_at(width: int) -> float:
        images = [image for member in images_at(width) for image in member]
        return column_gaps(images) or 0.0

    suited = next((w for w in (wide, *widths) if gaps_at(w) <= MAX_COLUMN_GAPS), widths[-1])
    if suited == wide:
        return wide
    gaps = f"{percentage(gaps_at(wide), 0)} of the pixels between columns of the sensor are empty"
    if settings.is_width_named or wide != trained[0]:
        remedy = f"omit {argument('width')}, or use {setting('width', suited)}"
        text = f"{gaps} in images of {wide} columns"
        log.log(NOTICE, "%s", with_hint(text, remedy))
        return wide
    log.log(NOTICE, "%s in images of %d columns: %d columns replace them", gaps, wide, suited)
    return suited
