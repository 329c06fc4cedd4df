# SPDX-License-Identifier: MIT
"""Options that commands on results share: selection of scans and classes."""

from pathlib import Path
from typing import TYPE_CHECKING

from salsanext_cli.option_fields import ScanSelection, option_group, selection_option

if TYPE_CHECKING:
    from salsanext_cli.classes.label_space import LabelSpace

DATASET_VARIABLE = "SALSANEXT_DATASET"


def named_label_space(name: str | None) -> "LabelSpace | None":
    """Return the label space of a name, None without one."""
    from salsanext_cli.classes.label_space import label_space

    return None if name is None else label_space(name)


@option_group
class ResultQuery:
    """Selection of the results of a folder, and of the classes in which they are compared."""

    dataset: Path | None = selection_option(
        "Data set with the scans and labels; SALSANEXT_DATASET for results that do not record it.",
        show_default="the one that the results record, else .",
    )
    selection: ScanSelection = ScanSelection()
    # Label space of the labels, if it is not that of the data set
    label_space: "LabelSpace | None" = selection_option(
        "Name of a built-in label space, or a .yaml file in SemanticKITTI's format.",
        show_default="that of the data set, else semantic-kitti",
        parse=named_label_space,
    )
    # Label space into whose classes labels and predictions are merged
    classes: "LabelSpace | None" = selection_option(
        "Merge the classes into those of a label space: coarse, or a .yaml file. "
        "Probabilities of merged classes are added.",
        show_default="not merged",
        parse=named_label_space,
    )
