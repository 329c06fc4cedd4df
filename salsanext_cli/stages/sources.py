# SPDX-License-Identifier: MIT
"""Where the scans came from whose results an output folder holds."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.formats.json_files import read_json
from salsanext_cli.formats.layout import SUFFIX_OF_FOLDER, ScanFile, find_outputs, find_scans

SOURCE = "source.json"


def new_sources(out: Path, scans: Sequence[ScanFile]) -> dict[Path, str]:
    """Return what to record of where scans come from.

    Raises
    ------
    OutputError
        If a sequence of that name came from another folder: the results would overwrite each
        other.
    """
    new: dict[Path, str] = {}
    for sequence, folder in sorted({(scan.sequence, str(scan.path.parent)) for scan in scans}):
        path = out / "sequences" / sequence / SOURCE
        recorded = new.get(path) or (read_json(path) or {}).get("scans")
        if recorded not in (None, folder):
            raise OutputError(
                path,
                f"sequence {sequence} came from {recorded}",
                f"scans from there, not from {folder}",
                "use another output folder",
            )
        if recorded is None:
            new[path] = folder
    return new


def remembered_scans(
    out: Path, dataset: Path | None = None, usual: Path = Path()
) -> list[ScanFile]:
    """Find the scans whose results an output folder holds.

    Parameters
    ----------
    out : Path
        The output folder.
    dataset : Path, optional
        Where to look instead of where the scans came from.
    usual : Path
        Where to look if nobody recorded where the scans came from, or they are gone.

    Raises
    ------
    NoInputError
        If there is no such folder, it holds no results, or a sequence's scans are not to be found.
    """
    sequences = sorted(
        {file.sequence for folder in SUFFIX_OF_FOLDER for file in find_outputs(out, folder)}
    )
    if not sequences:
        found = "holds no results" if out.is_dir() else "no such folder"
        remedy = f"run `salsanext predict SCANS {out}` first"
        raise NoInputError(out, found, "the output folder of an earlier stage", remedy)
    if (
        dataset
        and len(sequences) == 1
        and dataset.is_dir()
        and not (dataset / "sequences").is_dir()
    ):
        # The folder of the scans themselves, which may have another name by now.
        return [replace(scan, sequence=sequences[0]) for scan in find_scans(dataset)]
    return [scan for name in sequences for scan in _scans_of_sequence(out, name, dataset, usual)]


def _scans_of_sequence(
    out: Path, sequence: str, dataset: Path | None, usual: Path
) -> list[ScanFile]:
    recorded = (read_json(out / "sequences" / sequence / SOURCE) or {}).get("scans")
    if dataset is None and recorded and Path(recorded).is_dir():
        return find_scans(Path(recorded))
    root = dataset or usual
    if (root / "sequences").is_dir():
        return find_scans(root, [sequence])
    raise NoInputError(
        out / "sequences" / sequence,
        f"its scans are not in {dataset or recorded or root.absolute()}",
        "the folder that they came from",
        "give with --dataset the folder that holds sequences/",
    )
