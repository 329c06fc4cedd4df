# SPDX-License-Identifier: MIT
"""Colour scales of values that are the same for all scans of a run."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import SalsanextError
from salsanext_cli.report.colours import CLASS_COLOURS, value_range
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.result_folder import ResultFolder
from salsanext_cli.results.scan_results import scalar_columns
from salsanext_cli.sensors.sensor import Sensor

SCANS_FOR_SCALE = 20

Scales = dict[str, tuple[float, float]]
"""Values at the ends of the colour map, by colour."""


def common_scales(
    out: Path, scans: Sequence[ScanFile], colours: Iterable[str], space: LabelSpace, sensor: Sensor
) -> Scales:
    """Find what most points of some evenly spaced scans span; class colours have no scale."""
    folder = ResultFolder(out)
    values: dict[str, list[npt.NDArray[Any]]] = {}
    sampled: dict[ScanFile, list[str]] = {}
    for colour in [each for each in colours if each not in CLASS_COLOURS]:
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
