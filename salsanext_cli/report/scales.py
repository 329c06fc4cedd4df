# SPDX-License-Identifier: MIT
"""Colour scales of values that are the same for all scans of a run."""

import math
from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import SalsanextError, UsageError
from salsanext_cli.report.colours import CLASS_COLOURS, COLOURS, value_range
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.result_folder import ResultFolder, scalar_columns
from salsanext_cli.sensors.sensor import Sensor

SCANS_FOR_SCALE = 20

Scales = dict[str, tuple[float, float]]
"""Values at the ends of the colour map, by colour."""


def common_scales(
    out: Path,
    scans: Sequence[ScanFile],
    colours: Iterable[str],
    space: LabelSpace,
    sensor: Sensor,
) -> Scales:
    """Find what most points of some evenly spaced scans span.

    `out`: output folder of earlier stages; `scans`: those of the run; `colours`: of `COLOURINGS`;
    classes have no scale and are left out; `space`: classes of the labels; `sensor`: what distances
    are measured from.
    """
    folder = ResultFolder(out)
    values: dict[str, list[npt.NDArray[Any]]] = {}
    sampled: dict[ScanFile, list[str]] = {}
    for colour in colours:
        if colour in CLASS_COLOURS:
            continue
        values[colour] = [np.empty(0, np.float32)]
        known = folder.with_column(colour, scans)
        for file in known[:: -(-len(known) // SCANS_FOR_SCALE) or 1]:
            sampled.setdefault(file, []).append(colour)
    for file, wanted in sampled.items():
        # A scan that cannot be read is named when it is worked on.
        with suppress(SalsanextError):
            columns = scalar_columns(folder.read(file, sensor), space)
            for colour in wanted:
                values[colour].append(columns[colour])
    return {colour: value_range(np.concatenate(found)) for colour, found in values.items()}


def require_colouring(colours: Iterable[str], scale: tuple[float, float] | None) -> None:
    """Refuse colours that there are not, and a scale that is none."""
    for colour in colours:
        if colour not in COLOURS:
            raise UsageError("--colour", colour, f"one of {', '.join(COLOURS)}")
    if scale and not (scale[0] < scale[1] and all(map(math.isfinite, scale))):
        raise UsageError("--scale", f"{scale[0]} {scale[1]}", "a lower and a higher number")
