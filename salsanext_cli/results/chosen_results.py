# SPDX-License-Identifier: MIT
"""Selection among the scans of which an output folder holds labels or uncertainties."""

from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.classes.label_space import LabelSpace
from salsanext_cli.options import ScanSelection
from salsanext_cli.results.layout import ScanFile
from salsanext_cli.results.predictions import (
    require_same_weights,
    space_of_labels,
    space_of_results,
)
from salsanext_cli.results.scan_results import with_results
from salsanext_cli.results.selection import choose
from salsanext_cli.results.sources import MissingResults, missing_results, recorded_scans


@dataclass(frozen=True, slots=True)
class ChosenResults:
    """Scans with results, and those that lack them."""

    scans: list[ScanFile]  # With labels or an uncertainty, at least one
    space: LabelSpace  # Classes of their labels
    # Meaning of the raw ids of the truth, which may have its own for these classes
    labels: LabelSpace
    missing: MissingResults  # The other scans of the selection
    # All scans of the sequences that there are results of, as `recorded_scans` finds them
    recorded: list[ScanFile]


def choose_results(
    out: Path,
    selection: ScanSelection,
    dataset: Path | None = None,
    space: LabelSpace | None = None,
    classes: LabelSpace | None = None,
) -> ChosenResults:
    """Choose among the scans of which any stage left results; log how many lack them.

    A limit is of scans with results.

    `out`, `selection`, `dataset`, `space`, `classes`: as for `predictions.predicted_scans`.
    """
    recorded = recorded_scans(out, dataset)
    given, space = space, space_of_results(out, recorded, space, classes, own_ids=True)
    require_same_weights(out)
    chosen = choose(recorded, ScanSelection(selection.split, selection.sequences), space, out)
    scans = with_results(out, chosen)[: selection.limit]
    if len(scans) == selection.limit:
        # What comes after the last that is wanted is not looked at.
        chosen = chosen[: chosen.index(scans[-1]) + 1]
    missing = missing_results(out, set(chosen) - set(scans))
    missing.log_error(len(chosen), "results")
    labels = space_of_labels(recorded, space, given)
    return ChosenResults(scans, space, labels, missing, recorded)
