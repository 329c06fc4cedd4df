# SPDX-License-Identifier: MIT
"""Choice among the results of a folder: which scans, and in which classes."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.runs.scans.scan_selection import ScanSelection

if TYPE_CHECKING:
    from salsanext_cli.core.classes.label_space import LabelSpace

DATASET_VARIABLE = "SALSANEXT_DATASET"


def named_label_space(name: str | None) -> "LabelSpace | None":
    """Look up a label space; return None for no name."""
    from salsanext_cli.io.label_spaces import label_space

    return None if name is None else label_space(name)


@dataclass(frozen=True, slots=True)
class ResultQuery:
    """Choice among the results of a folder, and of the classes in which they are compared.

    `label_space` is that of the labels, if not that of the data set. Labels and predictions are
    merged into `classes`.
    """

    dataset: Path | None = None
    selection: ScanSelection = ScanSelection()
    label_space: "LabelSpace | None" = None
    classes: "LabelSpace | None" = None
