# SPDX-License-Identifier: MIT
"""Scans behind the results of an output folder: where they lie, and which were asked for."""

import logging
import os
from collections.abc import Container, Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from salsanext_cli.errors import NoInputError, OutputError, counted, first_few, shortened
from salsanext_cli.files.reading import is_folder
from salsanext_cli.formats import scan_suffix
from salsanext_cli.formats.recordings import recording_of
from salsanext_cli.results.layout import (
    SCAN_FOLDER,
    SUFFIX_OF_FOLDER,
    ScanFile,
    find_outputs,
    find_scans,
    names_in,
)
from salsanext_cli.results.stage_records import ScanSource, owner, read_records

LABELLING_STAGES = ("predict", "knn-refine", "uncertainty")
"""The stages whose results later ones read."""
DATASET_VARIABLE = "SALSANEXT_DATASET"
MAX_PATH_SHOWN = 500
"""Characters of a folder's name that an error shows."""

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class MissingResults:
    """Scans without results."""

    # Those that a stage was asked for: it failed, was interrupted, or its results were deleted.
    # All, where no stage recorded what it was asked for
    scans: tuple[ScanFile, ...] = ()
    not_asked_for: int = 0  # Number of the others, which were left out on purpose

    def log_error(self, count: int, what: str) -> None:
        """Log how many of so many scans lack what they should have."""
        if self.scans:
            first = self.scans[0]
            log.error(
                "%d of %d scans have no %s and are left out, the first is %s/%s",
                *(len(self.scans), count, what, first.sequence, first.stem),
            )


def scan_sources(out: Path, scans: Iterable[ScanFile]) -> dict[str, ScanSource]:
    """Return where scans lie and their stems, by sequence."""
    known: dict[str, str] = {}
    for record in read_records(out).values():
        known |= {sequence: source.folder for sequence, source in record.scans.items()}
    stems: dict[str, set[str]] = {}
    for scan in scans:
        folder = str(scan.path.parent)
        recorded = known.setdefault(scan.sequence, folder)
        if recorded != folder:
            raise OutputError(
                out,
                f"sequence {scan.sequence} came from {shortened(recorded, MAX_PATH_SHOWN)}",
                f"scans from there, not from {folder}",
                "use another output folder",
            )
        stems.setdefault(scan.sequence, set()).add(scan.stem)
    return {name: ScanSource(known[name], frozenset(names)) for name, names in stems.items()}


def recorded_scans(
    out: Path, dataset: Path | None = None, sequence: str | None = None
) -> list[ScanFile]:
    """Find the scans whose results an output folder holds.

    If it is not recorded where scans came from, or they are gone, they are looked for in the
    folder that the environment variable `DATASET_VARIABLE` names, else in the working folder.
    Results whose scan is not there any more are told.

    `out`: the output folder; `dataset`: where to look instead of where the scans came from;
    `sequence`: only the scans of this one.
    """
    there = {key for folder in SUFFIX_OF_FOLDER for key in find_outputs(out, folder)}
    wanted = {key for key in there if sequence in (None, key[0])}
    sequences = sorted({name for name, _ in wanted})
    if not sequences:
        reason = "holds no results" if out.is_dir() else "no such folder"
        remedy = f"run `salsanext predict SCANS {out}` first"
        raise NoInputError(out, reason, "the output folder of an earlier stage", remedy)
    if dataset and len(sequences) == 1 and _holds_scans(dataset):
        # The folder of the scans themselves, or the recording, which may have another name by now.
        found = [replace(scan, sequence=sequences[0]) for scan in find_scans(dataset)]
    else:
        known = {
            sequence: source
            for record in read_records(out).values()
            for sequence, source in record.scans.items()
        }
        found = [
            scan
            for name in sequences
            for scan in _scans_of_sequence(out, name, known.get(name), dataset)
        ]
    if gone := sorted(wanted - {(scan.sequence, scan.stem) for scan in found}):
        scans = counted(len(gone), "scan")
        log.warning(
            "%s with results not found any more and left out: %s",
            scans,
            first_few(["/".join(key) for key in gone]),
        )
    return found


def _holds_scans(dataset: Path) -> bool:
    """Say whether it is a folder of scans or a recording, not a data set."""
    if recording_of(dataset.absolute()):
        return True
    return dataset.is_dir() and not (dataset / "sequences").is_dir()


def _scans_of_sequence(
    out: Path, sequence: str, source: ScanSource | None, dataset: Path | None
) -> list[ScanFile]:
    folder = Path(source.folder) if source else None
    if dataset is None and source and folder and (is_folder(folder) or recording_of(folder)):
        scans = find_scans(folder)
        return scans + _scans_named_themselves(source, {scan.stem for scan in scans})
    root = dataset or Path(os.environ.get(DATASET_VARIABLE, ""))
    if (root / "sequences").is_dir():
        own = root / "sequences" / sequence / SCAN_FOLDER
        # Not all of a data set once for each of its sequences.
        return find_scans(own) if is_folder(own) else find_scans(root, [sequence])
    looked_in = shortened(str(dataset or folder or root.absolute()), MAX_PATH_SHOWN)
    raise NoInputError(
        out / "sequences" / sequence,
        f"its scans are not in {looked_in}",
        "the folder that they came from",
        "give with --dataset the folder that holds sequences/",
    )


def _scans_named_themselves(source: ScanSource, found: Container[str]) -> list[ScanFile]:
    """Return the files of a folder that were asked for by name and are no scans otherwise."""
    wanted = {stem for stem in source.stems if stem not in found}
    folder = Path(source.folder)
    tables = [name for name in names_in(folder) if scan_suffix(name)] if wanted else []
    scans = [scan for name in tables for scan in find_scans(folder / name)]
    return [scan for scan in scans if scan.stem in wanted]


def missing_predictions(out: Path, scans: Iterable[ScanFile]) -> MissingResults:
    """Divide scans without predictions by whether the stage that predicts was asked for them."""
    sources = {stage: record.scans for stage, record in read_records(out).items()}
    # `knn-refine` takes what `predict` left, wherever that came from.
    of_stage = sources.get(owner(out, "predictions") or "") or sources.get("predict", {})
    return _missing_results(scans, [of_stage])


def missing_results(out: Path, scans: Iterable[ScanFile]) -> MissingResults:
    """Divide scans without labels and uncertainty by whether any stage was asked for them."""
    records = read_records(out)
    return _missing_results(scans, [records[s].scans for s in LABELLING_STAGES if s in records])


def _missing_results(
    scans: Iterable[ScanFile], sources: Sequence[dict[str, ScanSource]]
) -> MissingResults:
    listed = sorted(scans, key=lambda scan: (scan.sequence, scan.stem))

    def is_asked_for(scan: ScanFile) -> bool:
        recorded = [of_stage[scan.sequence] for of_stage in sources if scan.sequence in of_stage]
        return not recorded or any(scan.stem in source.stems for source in recorded)

    missing = tuple(scan for scan in listed if is_asked_for(scan))
    return MissingResults(missing, len(listed) - len(missing))
