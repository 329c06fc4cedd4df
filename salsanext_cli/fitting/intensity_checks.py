# SPDX-License-Identifier: MIT
"""Checks of the intensity of a scan against that of others, or of training."""

from collections.abc import Iterator

import numpy as np

from salsanext_cli.fitting.findings import MIN_POINTS, UNCHECKED, Finding, ScanCheck
from salsanext_cli.geometry.intensity import (
    BRIGHT,
    INTENSITY_FACTOR,
    NO_INTENSITY,
    without_intensity,
)
from salsanext_cli.records import Float
from salsanext_cli.sensors.sensor import Sensor

MAX_USUAL_INTENSITY = 2.0
"""Largest upper intensity of the scale 0…1, where that of training is not known."""
NAME_IT = (
    "if the files hold one, name its column, --columns x,y,z,_,intensity for example, or its "
    "scale, intensity_scale in a file for --sensor"
)


def upper_intensity(intensity: Float) -> float:
    """Return the upper intensity of those that are numbers, 0 without any."""
    finite = intensity[np.isfinite(intensity)]
    return float(np.quantile(finite, BRIGHT)) if len(finite) else 0.0


def intensity_findings(
    bright: float, reason: str, sensor: Sensor, trained: Sensor, fitting: bool
) -> Iterator[Finding]:
    """Compare an upper intensity with that of scans matched with, of training, or with 0 to 1.

    `reason` says why the values are no intensity, if they are none.
    """
    matched = sensor.intensity_quantiles
    if reason:
        found = reason if matched else f"{reason}; the network takes it as it is"
        remedy = (
            "--intensity none"
            if fitting and trained.intensity_quantiles and not matched
            else NAME_IT
        )
        yield Finding("no-intensity", found, remedy)
        return
    quantiles = matched or trained.intensity_quantiles
    if matched == NO_INTENSITY:
        return
    if bright < 0 and not matched:
        found = f"{BRIGHT:.0%} of the intensities are below {bright:.3g}: negative"
        yield Finding(
            "intensity-scale", found, "name another column: --columns, or --intensity none"
        )
        return
    if quantiles:
        usual = quantiles[round(BRIGHT * (len(quantiles) - 1))]
        near = usual / INTENSITY_FACTOR <= bright <= usual * INTENSITY_FACTOR
        doubtful = usual > 0 and not near  # Those below 0 have no factors.
        of = f"and {usual:.2g} in {'the scans fitted to' if matched else 'training'}"
    else:
        doubtful, of = bright > MAX_USUAL_INTENSITY, "where 0 to 1 is usual"
    if doubtful:
        found = f"{BRIGHT:.0%} of the intensities are below {bright:.3g}, {of}"
        scale = "set intensity_scale in a file for --sensor"
        alone = "run it apart, or " if fitting else ""
        remedy = f"{alone}{scale}" if matched or not fitting else f"--intensity auto, or {scale}"
        yield Finding("intensity-scale", found, remedy)


def check_image(channels: Float, sensor: Sensor, trained: Sensor) -> ScanCheck:
    """Check the intensity of a range image, whose geometry was checked when it was projected.

    `channels` (5, H, W) float32, a pixel of range 0 is empty; `sensor`, `trained`: that of the
    image, and that of the weights.
    """
    occupied = channels[:, channels[0] > 0]
    if occupied.shape[1] < MIN_POINTS:
        return UNCHECKED
    reason, bright = without_intensity(occupied[1:4].T, occupied[4]), upper_intensity(occupied[4])
    return ScanCheck(tuple(intensity_findings(bright, reason, sensor, trained, fitting=True)))
