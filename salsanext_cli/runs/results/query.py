# SPDX-License-Identifier: MIT
"""Options of commands on results: which scans, and in which classes."""

from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.runs.option_fields import ScanSelection, option_group, selection_option

if TYPE_CHECKING:
    from salsanext_cli.core.classes.label_space import LabelSpace

DATASET_VARIABLE = "SALSANEXT_DATASET"


def named_label_space(name: str | None) -> "LabelSpace | None":
    """Look up a label space; return None for no name."""
    from salsanext_cli.io.label_spaces import label_space

    return None if name is None else label_space(name)


@option_group
class ResultQuery:
    """Choice among the results of a folder, and of the classes in which they are compared.

    `label_space` is that of the labels, if not that of the data set. Labels and predictions are
    merged into `classes`.
    """

    dataset: Path | None = selection_option(
        "Data set with the scans and labels, for results that do not record it; also "
        "SALSANEXT_DATASET.",
        show_default="the recorded data set, else the current folder",
    )
    selection: ScanSelection = ScanSelection()
    label_space: "LabelSpace | None" = selection_option(
        "Label space of the labels: built-in, or a .yaml file in SemanticKITTI's format.",
        metavar="NAME|FILE",
        show_default="label space of the data set, else semantic-kitti",
        parse=named_label_space,
    )
    classes: "LabelSpace | None" = selection_option(
        "Merge classes: `coarse`, or a label-space file.",
        metavar="coarse|FILE",
        parse=named_label_space,
    )
