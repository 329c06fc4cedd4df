# SPDX-License-Identifier: MIT
"""Picked scans as a table and as coloured clouds, and the reasons in words."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, fields
from typing import Any

import numpy as np
import numpy.typing as npt
from rich.table import Table

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.geometry.projection import points_from_pixels
from salsanext_cli.core.labelling import LabelledScan
from salsanext_cli.core.measures.scan_choice import Choice
from salsanext_cli.core.records import Float
from salsanext_cli.core.texts import counted
from salsanext_cli.io.formats.ply import encode_ply
from salsanext_cli.report.tables import ABSENT, table_of
from salsanext_cli.runs.annotation.picked_data_set import PickedScan
from salsanext_cli.runs.annotation.scan_description import ScanDescription
from salsanext_cli.runs.scans.scan_file import ScanFile


def picked_cloud(labelled: LabelledScan, uncertainty: Float, space: LabelSpace) -> bytes:
    """Return a PLY of a scan, coloured by label, with scalars for CloudCompare."""
    scan = labelled.checked.scan
    labels = labelled.labels
    columns: dict[str, npt.NDArray[Any]] = dict(zip("xyz", scan.points.T, strict=True))
    columns |= zip(("red", "green", "blue"), space.colours[labels].T, strict=True)
    # CloudCompare takes properties with the prefix scalar_ for scalars.
    columns["scalar_label"] = space.to_raw(labels)
    pixels = labelled.checked.range_image().pixel_of_point
    columns["scalar_uncertainty"] = points_from_pixels(uncertainty, pixels, np.nan)
    columns["scalar_intensity"] = scan.intensity
    return encode_ply(columns, ["scalar_label: raw ids of labels.yaml"])


def reason(choice: Choice, scans: int, nearest: str | None) -> str:
    """Return why one of a number of scans was picked; `nearest`: the most similar earlier scan."""
    if scans == 1:
        return "the only scan"
    if nearest is None:
        return f"most uncertain of {counted(scans, 'scan')}"
    if choice.distance == 0:
        return f"equal to {nearest}; no others remain"
    uncertain = f"number {choice.uncertainty_rank} of {scans:,} by uncertainty"
    return f"{uncertain}, {choice.distance:.2f} from {nearest}"


def picked_scans(choices: Sequence[Choice], files: Sequence[ScanFile]) -> list[PickedScan]:
    """Return the chosen scans with the reasons in words."""
    picked = []
    for rank, choice in enumerate(choices, start=1):
        file = files[choice.scan]
        is_first = choice.nearest is None
        nearest = None if choice.nearest is None else files[choice.nearest].name
        picked.append(
            PickedScan(
                rank=rank,
                sequence=file.sequence,
                scan=file.stem,
                uncertainty=choice.uncertainty,
                distance=None if is_first else choice.distance,
                nearest=nearest,
                reason=reason(choice, len(files), nearest),
            )
        )
    return picked


def scans_of_list(described: Sequence[ScanDescription]) -> list[PickedScan]:
    """Return the scans of a list as picked scans, in its order."""
    return [
        PickedScan(
            rank=rank,
            sequence=scan.file.sequence,
            scan=scan.file.stem,
            uncertainty=scan.uncertainty,
            distance=None,
            nearest=None,
            reason="in the list",
        )
        for rank, scan in enumerate(described, start=1)
    ]


def picked_table(picked: Sequence[PickedScan]) -> Table:
    """Return a table of the picked scans, the most useful to label first."""
    rows = []
    for scan in picked:
        distance = ABSENT if scan.distance is None else f"{scan.distance:.2f}"
        rows.append((str(scan.rank), scan.name, f"{scan.uncertainty:.4f}", distance, scan.reason))
    headings = ("rank", "scan", "uncertainty,\nnats", "distance", "reason")
    return table_of(headings, rows, texts=("scan", "reason"))


def picked_csv(picked: Sequence[PickedScan]) -> bytes:
    """Return a CSV table of the picked scans."""
    text = io.StringIO()
    names = [field.name for field in fields(PickedScan)]
    table = csv.DictWriter(text, names, lineterminator="\n")
    table.writeheader()
    table.writerows(map(asdict, picked))
    return text.getvalue().encode("utf-8", "backslashreplace")
