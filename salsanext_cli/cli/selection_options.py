# SPDX-License-Identifier: MIT
"""Options that more than one command takes, about scans, results and label spaces."""

from __future__ import annotations

import os
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from salsanext_cli.cli.option_groups import argument, option, option_group
from salsanext_cli.errors import UsageError

if TYPE_CHECKING:
    from salsanext_cli.classes.label_space import LabelSpace
    from salsanext_cli.results.selection import ScanSelection

OUT_VARIABLE = "SALSANEXT_OUT"
TOPIC_HELP = "Topic of the point clouds of a recording."
Topic = Annotated[str | None, typer.Option(help=TOPIC_HELP, show_default="the only one")]

selection_option = partial(option, "Selection")


@option_group
class Selection:
    """Selection among the scans of a source."""

    dataset: Path | None = selection_option(
        "Data set in SemanticKITTI's layout.", envvar="SALSANEXT_DATASET", show_default="."
    )
    split: str | None = selection_option("Only the sequences of this split: train, valid or test.")
    sequences: str | None = selection_option("Only these sequences, such as 00,08.")
    limit: int | None = selection_option("At most this number of scans, the first ones.")

    def source(self, scans: Path | None) -> Path:
        """Return where to look for scans: SCANS, else the data set, else the current folder."""
        return scans or self.dataset or Path()

    def scans(self) -> ScanSelection:
        """Build the selection that stages take."""
        from salsanext_cli.results.selection import ScanSelection

        names = tuple(name.strip() for name in (self.sequences or "").split(",") if name.strip())
        if self.sequences is not None and not names:
            expected = "names of sequences, such as 00,08"
            raise UsageError("--sequences", repr(self.sequences), expected)
        return ScanSelection(self.split, names, self.limit)


@option_group
class Results:
    """Output folder of earlier stages, given as OUT or as --out."""

    out: Path | None = argument(
        "Folder with the results of earlier stages.",
        metavar="OUT",
        show_default=f"{OUT_VARIABLE}, else out",
    )
    out_option: Path | None = option("Options", "The same as OUT.", "--out")

    def folder(self) -> Path:
        """Return the output folder, which may be given once."""
        if self.out and self.out_option:
            raise UsageError("OUT and --out", "both given", "one of them")
        return self.out or self.out_option or Path(os.environ.get(OUT_VARIABLE) or "out")


@option_group
class SourceSelection(Selection):
    """Selection among the scans of a source that may be a recording."""

    topic: str | None = selection_option(TOPIC_HELP, show_default="the only one")

    def source(self, scans: Path | None) -> Path:
        """Return where to look for scans, in a recording the topic that was named."""
        return in_topic(Selection.source(self, scans), self.topic)


@option_group
class PickedSelection(SourceSelection):
    """Selection among the scans to pick from, whose limit takes scans evenly spaced."""

    limit: int | None = selection_option("Look at this number of scans only, evenly spaced.")


def in_topic(source: Path, topic: str | None) -> Path:
    """Return the path of a topic in a recording, of the recording where none is named."""
    if topic is None:
        return source
    from salsanext_cli.formats.recordings.address import is_recording

    if not is_recording(source):
        raise UsageError("--topic", f"{source} is no recording", "SCANS that are one")
    return source / topic.strip("/")


@option_group
class SpacedSelection(Selection):
    """Selection whose limit takes scans evenly spaced."""

    limit: int | None = selection_option("At most this number of scans, evenly spaced.")


@option_group
class LabelledSelection(SpacedSelection):
    """Selection among labelled scans: those for validation, unless others are named."""

    split: str | None = selection_option(
        "Only the sequences of this split: train or valid.",
        show_default="valid, without --sequences",
    )

    def scans(self) -> ScanSelection:
        """Build the selection that stages take."""
        split = self.split or (None if self.sequences else "valid")
        return Selection(self.dataset, split, self.sequences, self.limit).scans()


@option_group
class Classes:
    """Label space of the data."""

    label_space: str | None = selection_option(
        "Name of a built-in label space, or a .yaml file in SemanticKITTI's format.",
        show_default="that of the data set, else semantic-kitti",
    )

    def space(self) -> LabelSpace | None:
        """Look up the label space, None where none was named."""
        return label_space(self.label_space)


@option_group
class ResultSelection(Selection):
    """Selection among the scans of which an output folder holds results."""

    dataset: Path | None = selection_option(
        "Data set with the scans and labels; SALSANEXT_DATASET for results that do not record it.",
        show_default="the one that the results record, else .",
    )


def label_space(name: str | None) -> LabelSpace | None:
    """Look up a label space, None where none was named."""
    from salsanext_cli.classes.label_space import label_space as find

    return None if name is None else find(name)
