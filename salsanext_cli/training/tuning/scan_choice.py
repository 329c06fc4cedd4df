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
from salsanext_cli.runs.labelling.label_records import require_labels
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.runs.results.scan_selection import ScanSelection
from salsanext_cli.runs.results.selection import (
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
class UnseenScans:
    """Scans that the weights were not trained on, in order, and the number of skipped ones."""

    files: list[ScanFile]
    skipped: int


def labelled_scans(
    dataset: Path, selection: ScanSelection, card: WeightsCard
) -> tuple[list[ScanFile], LabelSpace]:
    """Find labelled scans in the classes of a network, without regard to the limit.

    By default they are the scans of the split ``valid`` and of no split. As many as the limit
    allows must have labels.
    """
    files = scans_of(dataset)
    space = space_of(files, card.space)
    if not space.fits(card.space):
        problem = f"has labels of {space.name} ({first_few(space.differences(card.space))})"
        expected = f"labels of {card.space.name}, as the weights"
        raise LabelError(dataset, problem, expected, "use weights for these classes")
    scans = choose(files, replace(selection, limit=None), space, dataset)
    if not (selection.split or selection.sequences):
        splits = with_splits(space, data_set_of(scans[0]))
        splits_of_scans = {scan: splits.split_of(scan.sequence) for scan in scans}
        unsplit = [scan for scan in scans if not splits_of_scans[scan] and present(scan.label_path)]
        scans = sorted([scan for scan in scans if splits_of_scans[scan] == "valid"] + unsplit)
        hint = f"choose scans with {argument('sequences')}"
        if not scans:
            expected = "labelled scans of split valid, or of no split"
            if not any(present(scan.label_path) for scan in splits_of_scans):
                raise NoInputError(dataset, "has no labels", expected)
            raise NoInputError(dataset, "has no scans to tune on", expected, hint)
        log_unused(files, scans, splits, hint)
    require_labels(evenly_spaced(scans, selection.limit or 0))
    return scans, space


def unseen_scans(
    scans: Sequence[ScanFile], network: Network, source: Path, limit: int | None = None
) -> UnseenScans:
    """Choose scans that the weights were not trained on, without copies; log the others.

    With a limit the scans are evenly spaced, and further ones replace those that are skipped.
    """
    known = set(network.card.trained_on)
    remaining = list(scans)
    accepted = set[ScanFile]()
    skipped = 0
    while remaining and (missing := (limit or len(scans)) - len(accepted)):
        read = evenly_spaced(remaining, missing)
        remaining = sorted({*remaining} - {*read})
        require_labels(read)
        for scan in read:
            if (digest := scan_digest(read_scan(scan.path, network.sensor))) in known:
                skipped += 1
            else:
                known.add(digest)
                accepted.add(scan)
    reason = "the weights were trained on them, or they are copies"
    if not accepted:
        hint = f"label other scans, or choose others with {argument('sequences')}"
        raise TrainingError(source, f"every labelled scan is skipped: {reason}", hint=hint)
    if skipped:
        log.warning("%s skipped: %s", counted(skipped, "scan"), reason)
    return UnseenScans(files=[scan for scan in scans if scan in accepted], skipped=skipped)
