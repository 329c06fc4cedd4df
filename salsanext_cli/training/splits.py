# SPDX-License-Identifier: MIT
"""Splits of a labelled data set: the scans to train on and those to validate with."""

from dataclasses import replace
from pathlib import Path

from salsanext_cli.class_merging import is_merged
from salsanext_cli.classes import LabelSpace, label_space
from salsanext_cli.errors import NoInputError
from salsanext_cli.storage.layout import ScanFile, find_scans
from salsanext_cli.storage.selection import data_set_label_space


def labelled_splits(
    dataset: Path, space: LabelSpace | None
) -> tuple[LabelSpace, list[ScanFile], list[ScanFile]]:
    """Return the label space of a data set, and its scans for training and for validation.

    Parameters
    ----------
    dataset : Path
        Its root.
    space : LabelSpace, optional
        Otherwise what the data set says, else SemanticKITTI's. One that merges the data set's
        classes has its splits.

    Raises
    ------
    NoInputError
        If a split has no scans.
    """
    own = data_set_label_space(dataset)
    space = space or own or label_space()
    if own is not None and is_merged(space, own):
        space = replace(space, splits=own.splits)
    found: dict[str, list[ScanFile]] = {}
    for split in ("train", "valid"):
        members = space.split(split)
        found[split] = [scan for scan in find_scans(dataset) if scan.sequence in members]
        if not found[split]:
            raise NoInputError(
                dataset,
                f"no scans of split {split}",
                f"one of the sequences {', '.join(members) or '(none)'}",
                "name your sequences in labels.yaml, under split",
            )
    return space, found["train"], found["valid"]
