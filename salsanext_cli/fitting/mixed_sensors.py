# SPDX-License-Identifier: MIT
"""Scans of several sensors in one run."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.errors import first_few
from salsanext_cli.fitting.scan_checks import Finding, ScanTraits
from salsanext_cli.geometry.network_input import (
    INTENSITY_FACTOR,
)
from salsanext_cli.results.layout import ScanFile

DENSITY_FACTOR = 1.5
"""Least factor between the numbers of points that two sensors have around an elevation; scans of
one sensor had up to 1.27, the two most similar sensors 1.77."""
POINTS_FACTOR = 4.0
"""The same for all their points, of which the sky leaves more or less."""
LEAST_SHARE = 0.02
"""Points around an elevation, as a share of those of the largest scan, up to which they do not
count."""


def mixed_sensors(
    traits: Mapping[ScanFile, ScanTraits], *, selectable: bool = True
) -> dict[ScanFile, Finding]:
    """Return the scans of other sensors than most, with the reason.

    Scans differ if a gap of `DENSITY_FACTOR` divides them when all are sorted by one trait; a gap
    of the other factors for all points and for the intensity. Their order does not matter.

    `traits`: traits of the scans of a run; `selectable`: whether the command takes any SCANS.
    """
    files = sorted(traits, key=lambda file: (file.sequence, file.stem))
    if len(files) < 2:
        return {}
    least = LEAST_SHARE * max(traits[file].points for file in files)
    below = np.maximum([traits[file].below for file in files], least)
    points = np.array([traits[file].points for file in files])
    bright = np.array([traits[file].bright for file in files])
    columns = [_groups(column, DENSITY_FACTOR) for column in below.T]
    columns += [_groups(points, POINTS_FACTOR), _groups(bright, INTENSITY_FACTOR)]
    keys = list(zip(*(column.tolist() for column in columns), strict=True))
    # Of equally many, those of the first scan.
    usual = Counter(keys).most_common(1)[0][0]
    others = [file for file, key in zip(files, keys, strict=True) if key != usual]
    most = [file for file, key in zip(files, keys, strict=True) if key == usual]
    remedy = _remedy(others, most, selectable)
    shown = f"the others of the run, such as {most[0].sequence}/{most[0].stem}"
    of_most = _description(traits[most[0]])
    return {
        file: Finding(
            "mixed-sensors",
            f"seems to be of another sensor ({_description(traits[file])}) than {shown}"
            f" ({of_most})",
            remedy,
        )
        for file in others
    }


def _groups(values: npt.NDArray[Any], factor: float) -> npt.NDArray[np.int64]:
    """Return the numbers of the groups of values (F,) that gaps of a factor divide, from 0.

    A value of 0 is unknown and in the first group.

    Returns (F,) int64.
    """
    found = np.zeros(len(values), np.int64)
    known = np.flatnonzero(values > 0)
    order = known[np.argsort(values[known], kind="stable")]
    gaps = values[order][1:] > factor * values[order][:-1]
    found[order[1:]] = np.cumsum(gaps)
    return found


def _remedy(others: Sequence[ScanFile], most: Sequence[ScanFile], selectable: bool) -> str:
    """Return what divides a run, if whole sequences do, else other advice."""
    sequences = [sorted({file.sequence for file in files}) for files in (others, most)]
    if not selectable or {*sequences[0]} & {*sequences[1]}:
        return "put the scans of each sensor into a folder of their own"
    apart = " and ".join(first_few(names) for names in sequences)
    # A selection from the whole data set would be fitted to all of it.
    return f"give {apart} as SCANS of their own, such as {most[0].path.parent}"


def _description(traits: ScanTraits) -> str:
    view = f"{traits.fov_up:+.0f}° to {traits.fov_down:+.0f}°"
    bright = f", intensities to {traits.bright:.2g}" if traits.bright else ""
    return f"{traits.points:,} points, {view}{bright}"
