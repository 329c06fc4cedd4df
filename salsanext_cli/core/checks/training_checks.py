# SPDX-License-Identifier: MIT
"""Checks of images and intensities against those that a network was trained on."""

from collections.abc import Iterator

from salsanext_cli.core.checks.finding import Finding
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.geometry.intensity import (
    BRIGHT,
    BRIGHT_LEVEL,
    INTENSITY_FACTOR,
    NO_INTENSITY,
)
from salsanext_cli.core.sensors.sensor import OF_IMAGES, Sensor
from salsanext_cli.core.texts import first_few, percentage
from salsanext_cli.core.wording import argument, setting

MAX_USUAL_INTENSITY = 2.0  # Upper intensity of the scale 0…1, if that of training is unknown
SEPARATE_RUN_HINT = "label it alone, into another folder"
COLUMNS = "x,y,z,_,intensity"  # Example for a hint


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
    sensor : Sensor
        Sensor of the images.
    trained : Sensor
        Sensor of the weights.
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
        settings = f"{argument('width')}, or height and width in the sensor file"
        hint = f"accuracy drops: omit {settings}"
        yield Finding(WarningCode.OTHER_IMAGES, f"the images have {sizes} in training", hint)
    elif any(getattr(sensor, key) != getattr(trained, key) for key in OF_IMAGES):
        problem = "the sensor file changes the normalisation of the images"
        hint = "accuracy drops: omit means and stds from the file"
        yield Finding(WarningCode.OTHER_IMAGES, problem, hint)


def _no_intensity(
    reason: str, trained: Sensor, fields: tuple[str, ...], *, is_matched: bool
) -> Finding:
    """Return the finding of values that are no intensities."""
    if is_matched:
        return Finding(WarningCode.NO_INTENSITY, reason, _name_of_intensity(fields))
    is_known = bool(trained.intensity_quantiles)
    hint = setting("intensity", "none") if is_known else _name_of_intensity(fields)
    return Finding(WarningCode.NO_INTENSITY, f"{reason}; the network takes it as it is", hint)


def _name_of_intensity(fields: tuple[str, ...]) -> str:
    """Return the hint to name the intensity, which lists the fields of a file with names."""
    if not fields:
        named = f"name the columns of files without names: {setting('columns', COLUMNS)}"
        return f"if the files have one, {named} for example"
    choice = f"one of {first_few(fields)}" if len(fields) > 1 else fields[0]
    named = setting("intensity_field", fields[0])
    return f"if {choice} is the intensity, {named} for example"


def _scale_findings(bright: float, sensor: Sensor, trained: Sensor) -> Iterator[Finding]:
    """Compare the upper intensity with that of the scans fitted to, else of training."""
    matched = sensor.intensity_quantiles
    quantiles = matched or trained.intensity_quantiles
    if quantiles:
        expected = quantiles[BRIGHT_LEVEL]
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
    yield Finding(
        WarningCode.INTENSITY_SCALE, problem, SEPARATE_RUN_HINT if matched else _scale_hint(trained)
    )


def _scale_hint(trained: Sensor) -> str:
    """Return the hint to match the intensity, if the weights state theirs, or to scale it."""
    scaled = f"set intensity_scale in a file for {argument('sensor')}"
    if trained.intensity_quantiles:
        return f"{setting('intensity', 'auto')}, or {scaled}"
    return scaled
