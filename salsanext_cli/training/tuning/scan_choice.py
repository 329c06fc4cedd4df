# SPDX-License-Identifier: MIT
"""Choice of the labelled scans that one part of the weights is fitted to."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import LabelError, NoInputError, TrainingError
from salsanext_cli.core.network.card import WeightsCard, scan_digest
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.core.wording import argument
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats import read_scan
from salsanext_cli.runs.annotation.label_records import require_labels
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.scan_selection import ScanSelection
from salsanext_cli.runs.scans.selection import (
    choose,
    data_set_of,
    evenly_spaced,
    log_unused,
    scans_of,
    space_of,
    with_splits,
)

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class LabelledScans:
    """Scans of a data set that a part of the weights may be fitted to."""

    files: list[ScanFile]
    space: LabelSpace  # Classes of their labels


@dataclass(frozen=True, slots=True, kw_only=True)
class UnseenScans:
    """Scans that the weights were not trained on."""

    files: list[ScanFile]  # In the order of the labelled scans
    skipped: int  # Number of scans of the training, and of copies of other scans


def labelled_scans(dataset: Path, selection: ScanSelection, card: WeightsCard) -> LabelledScans:
    """Find scans with labels in the classes of a network.

    The limit of the selection does not shorten the result: skipped scans are replaced by others.

    Parameters
    ----------
    dataset : Path
        Data set.
    selection : ScanSelection
        Choice of the scans; by default those of the split ``valid`` and those of no split.
    card : WeightsCard
        Card of the weights.

    Returns
    -------
    LabelledScans

    Raises
    ------
    LabelError
        If the labels are of other classes, or a scan that the limit allows has none.
    NoInputError
        If no scan is left.
    """
    files = scans_of(dataset)
    space = space_of(files, card.space)
    if not space.fits(card.space):
        problem = f"has labels of {space.name} ({first_few(space.differences(card.space))})"
        expected = f"labels of {card.space.name}, as the weights"
        raise LabelError(dataset, problem, expected, "use weights for these classes")
    scans = choose(files, replace(selection, limit=None), space, dataset)
    if not (selection.split or selection.sequences):
        scans = _without_training_split(dataset, files, scans, space)
    require_labels(evenly_spaced(scans, selection.limit or 0))
    return LabelledScans(files=scans, space=space)


def _without_training_split(
    dataset: Path, files: list[ScanFile], scans: Sequence[ScanFile], space: LabelSpace
) -> list[ScanFile]:
    """Return the scans of the split ``valid``, and the labelled scans of no split."""
    splits = with_splits(space, data_set_of(scans[0]))
    split_of_scan = {scan: splits.split_of(scan.sequence) for scan in scans}
    valid_scans = [scan for scan in scans if split_of_scan[scan] == "valid"]
    scans_of_no_split = [
        scan for scan in scans if not split_of_scan[scan] and present(scan.label_path)
    ]
    chosen = sorted(valid_scans + scans_of_no_split)
    hint = f"choose scans with {argument('sequences')}"
    if not chosen:
        expected = "labelled scans of split valid, or of no split"
        if not any(present(scan.label_path) for scan in scans):
            raise NoInputError(dataset, "has no labels", expected)
        raise NoInputError(dataset, "has no scans to tune on", expected, hint)
    log_unused(files, chosen, splits, hint)
    return chosen


def unseen_scans(
    scans: Sequence[ScanFile], network: Network, source: Path, limit: int | None = None
) -> UnseenScans:
    """Choose scans that the weights were not trained on, and one of each group of copies.

    Parameters
    ----------
    scans : sequence of ScanFile
        Labelled scans.
    network : Network
        Network with the weights, which know their training scans.
    source : Path
        Data set, for errors.
    limit : int, optional
        Number of scans to choose, evenly spaced; others replace those that are skipped.

    Returns
    -------
    UnseenScans

    Raises
    ------
    LabelError
        If a scan has no labels.
    TrainingError
        If every scan is skipped.
    """
    count = limit or len(scans)
    seen_digests = set(network.card.trained_on)
    remaining = list(scans)
    accepted = set[ScanFile]()
    skipped = 0
    while remaining and len(accepted) < count:
        candidates = evenly_spaced(remaining, count - len(accepted))
        remaining = sorted({*remaining} - {*candidates})
        require_labels(candidates)
        for scan in candidates:
            digest = scan_digest(read_scan(scan.path, network.sensor))
            if digest in seen_digests:
                skipped += 1
            else:
                seen_digests.add(digest)
                accepted.add(scan)
    reason = "the weights were trained on them, or they are copies"
    if not accepted:
        hint = f"label other scans, or choose others with {argument('sequences')}"
        raise TrainingError(source, f"every labelled scan is skipped: {reason}", hint=hint)
    if skipped:
        log.warning("%s skipped: %s", counted(skipped, "scan"), reason)
    return UnseenScans(files=[scan for scan in scans if scan in accepted], skipped=skipped)
