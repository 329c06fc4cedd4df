# SPDX-License-Identifier: MIT
"""Picked scans as a table, as coloured clouds, and the reasons in words."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.table import Table

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.errors import counted
from salsanext_cli.fitting.label_scan import LabelledScan
from salsanext_cli.formats.ply import encode_ply
from salsanext_cli.geometry.projection import points_from_pixels
from salsanext_cli.labelling.picked_data_set import PickedScan
from salsanext_cli.labelling.scan_choice import Choice
from salsanext_cli.records import Float
from salsanext_cli.report.tables import ABSENT, table_of
from salsanext_cli.results.paths import ScanFile


def picked_cloud(labelled: LabelledScan, uncertainty: Float, space: LabelSpace) -> bytes:
    """Return a PLY of a scan, coloured by its labels, with scalars that CloudCompare shows."""
    scan, labels = labelled.scan, labelled.labels
    columns: dict[str, npt.NDArray[Any]] = dict(zip("xyz", scan.points.T, strict=True))
    columns |= zip(("red", "green", "blue"), space.colours[labels].T, strict=True)
    # CloudCompare takes properties of such names for scalars, without asking.
    columns["scalar_label"] = space.to_raw(labels)
    pixels = labelled.image.pixel_of_point
    columns["scalar_uncertainty"] = points_from_pixels(uncertainty, pixels, np.nan)
    columns["scalar_intensity"] = scan.intensity
    return encode_ply(columns, ["scalar_label: raw ids of labels.yaml"])


def reason(choice: Choice, scans: int, nearest: str | None) -> str:
    """State why one of so many scans was picked; `nearest`: the scan picked before."""
    if scans == 1:
        return "the only scan"
    if nearest is None:
        return f"most uncertain of {counted(scans, 'scan')}"
    if choice.distance == 0:
        return f"equal to {nearest}; no other is left"
    uncertain = f"number {choice.uncertainty_rank} of {scans:,} by uncertainty"
    return f"{uncertain}, {choice.distance:.2f} from {nearest}"


def picked_scans(choices: Sequence[Choice], files: Sequence[ScanFile]) -> list[PickedScan]:
    """Return the chosen ones of some scans, with the reasons in words."""
    picked = []
    for rank, choice in enumerate(choices, start=1):
        file, nearest, distance = files[choice.scan], None, None
        if choice.nearest is not None:
            before, distance = files[choice.nearest], choice.distance
            nearest = before.name
        why = reason(choice, len(files), nearest)
        of_choice = (choice.uncertainty, distance, nearest, why)
        picked.append(PickedScan(rank, file.sequence, file.stem, *of_choice))
    return picked


def picked_table(picked: Sequence[PickedScan]) -> Table:
    """Return a table with a row per picked scan, the one most worth labelling first."""
    rows = []
    for each in picked:
        distance = ABSENT if each.distance is None else f"{each.distance:.2f}"
        rows.append((str(each.rank), each.name, f"{each.uncertainty:.4f}", distance, each.reason))
    headings = ("rank", "scan", "uncertainty,\nnats", "distance", "reason")
    return table_of(headings, rows, texts=("scan", "reason"))


def picked_csv(picked: Sequence[PickedScan]) -> bytes:
    """Return the content of a CSV file with a row per picked scan."""
    text = io.StringIO()
    names = [field.name for field in fields(PickedScan)]
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(asdict(each) for each in picked)
    return text.getvalue().encode("utf-8", "backslashreplace")
