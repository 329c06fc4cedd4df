# SPDX-License-Identifier: MIT
"""Checks of images and intensities against those that a network was trained on."""

from collections.abc import Iterator
from shlex import quote

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.errors import first_few, percentage
from salsanext_cli.core.geometry.network_input import BRIGHT, INTENSITY_FACTOR, NO_INTENSITY
from salsanext_cli.core.sensors.sensor import OF_IMAGES, Sensor

MAX_USUAL_INTENSITY = 2.0  # Upper intensity of the scale 0…1, if that of training is unknown
APART = "label it alone, into another folder"
SET_SCALE = "set intensity_scale in a file for --sensor"
MATCH_OR_SET_SCALE = f"--intensity auto, or {SET_SCALE}"
NAME_COLUMN = (
    "if the files have one, name the columns of files without names: --columns x,y,z,_,intensity "
    "for example"
)


def training_findings(
    bright: float, reason: str, sensor: Sensor, trained: Sensor, fields: tuple[str, ...] = ()
) -> Iterator[Finding]:
    """Compare images and their intensities with training.

    Parameters
    ----------
    bright : float
        Upper intensity of the scan.
    reason : str
        Why the values are not intensities; empty if they are.
    sensor, trained : Sensor
        Sensor of the images, and of the weights.
    fields : tuple of str, optional
        Names of the fields of the file.

    Yields
    ------
    Finding
    """
    yield from _image_findings(sensor, trained)
    is_matched = bool(sensor.intensity_quantiles)
    if reason:
        yield _no_intensity(reason, trained, fields, is_matched=is_matched)
    elif sensor.intensity_quantiles != NO_INTENSITY:
        yield from _scale_findings(bright, sensor, trained)


def _image_findings(sensor: Sensor, trained: Sensor) -> Iterator[Finding]:
    """Compare size and normalisation of the images."""
    size = (sensor.height, sensor.width)
    trained_size = (trained.height, trained.width)
    if size != trained_size:
        sizes = f"{size[0]}×{size[1]} pixels, and {trained_size[0]}×{trained_size[1]}"
        hint = "accuracy drops: leave out --width, or height and width in the sensor file"
        yield Finding("other-images", f"the images have {sizes} in training", hint)
    elif any(getattr(sensor, key) != getattr(trained, key) for key in OF_IMAGES):
        problem = "the sensor file changes the normalisation of the images"
        hint = "accuracy drops: leave means and stds out of the file"
        yield Finding("other-images", problem, hint)


def _no_intensity(
    reason: str, trained: Sensor, fields: tuple[str, ...], *, is_matched: bool
) -> Finding:
    """Return the finding of values that are no intensities."""
    if is_matched:
        return Finding("no-intensity", reason, _name_of_intensity(fields))
    hint = "--intensity none" if trained.intensity_quantiles else _name_of_intensity(fields)
    return Finding("no-intensity", f"{reason}; the network takes it as it is", hint)


def _name_of_intensity(fields: tuple[str, ...]) -> str:
    """Return the hint to name the intensity, which lists the fields of a file with names."""
    if not fields:
        return NAME_COLUMN
    choice = f"one of {first_few(fields)}" if len(fields) > 1 else fields[0]
    return f"if {choice} is the intensity, --intensity-field {quote(fields[0])} for example"


def _scale_findings(bright: float, sensor: Sensor, trained: Sensor) -> Iterator[Finding]:
    """Compare the upper intensity with that of the scans fitted to, else of training."""
    matched = sensor.intensity_quantiles
    quantiles = matched or trained.intensity_quantiles
    if quantiles:
        expected = quantiles[round(BRIGHT * (len(quantiles) - 1))]
        is_near = expected / INTENSITY_FACTOR <= bright <= expected * INTENSITY_FACTOR
        is_doubtful = expected > 0 and not is_near  # Factors have no meaning below 0.
        origin = "the scans fitted to" if matched else "training"
        comparison = f"and {expected:.2g} in {origin}"
    else:
        is_doubtful = not 0 <= bright <= MAX_USUAL_INTENSITY
        comparison = "where 0 to 1 is usual"
    if not is_doubtful:
        return
    problem = f"{percentage(BRIGHT, 0)} of the intensities are below {bright:.3g}, {comparison}"
    hint = MATCH_OR_SET_SCALE if trained.intensity_quantiles else SET_SCALE
    yield Finding("intensity-scale", problem, APART if matched else hint)
