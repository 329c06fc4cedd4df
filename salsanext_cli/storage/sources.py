# SPDX-License-Identifier: MIT
"""Where the scans came from whose results an output folder holds, and which were asked for."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from salsanext_cli.errors import NoInputError, OutputError
from salsanext_cli.formats.reading import is_folder
from salsanext_cli.settings_files import shortened
from salsanext_cli.storage.json_files import read_json
from salsanext_cli.storage.layout import SUFFIX_OF_FOLDER, ScanFile, find_outputs, find_scans

SOURCE = "source.json"
ASKED = "asked_for"
LONGEST = 500
"""Characters of a folder's name that an error shows."""


def new_sources(
    out: Path, scans: Sequence[ScanFile], stage: str, *, anew: bool = False
) -> dict[Path, dict[str, Any]]:
    """Return what to record of where scans come from, and of which scans a stage was asked for.

    Parameters
    ----------
    out : Path
        The output folder.
    scans : sequence of ScanFile
        What the stage works on; added to what it was asked for before.
    stage : str
        Its name.
    anew : bool
        Whether its earlier results are removed, so that only these scans count.

    Raises
    ------
    OutputError
        If a sequence of that name came from another folder: the results would overwrite each
        other.
    """
    records: dict[Path, dict[str, Any]] = {}
    for (sequence, folder), stems in _stems_by_folder(scans).items():
        path = out / "sequences" / sequence / SOURCE
        recorded = records.get(path) or _record(path)
        if recorded.get("scans", folder) != folder:
            raise OutputError(
                path,
                f"sequence {sequence} came from {shortened(recorded['scans'], LONGEST)}",
                f"scans from there, not from {folder}",
                "use another output folder",
            )
        asked = recorded.get(ASKED, {})
        before = () if anew else asked.get(stage, ())
        records[path] = {"scans": folder, ASKED: asked | {stage: sorted({*before, *stems})}}
    return {path: record for path, record in records.items() if record != _record(path)}


def _stems_by_folder(scans: Sequence[ScanFile]) -> dict[tuple[str, str], list[str]]:
    found: dict[tuple[str, str], list[str]] = {}
    for scan in scans:
        found.setdefault((scan.sequence, str(scan.path.parent)), []).append(scan.stem)
    return dict(sorted(found.items()))


def _record(path: Path) -> dict[str, Any]:
    record = read_json(path) or {}
    asked, folder = record.get(ASKED, {}), record.get("scans", "")
    if not isinstance(asked, dict) or not all(map(_are_names, asked.values())):
        raise OutputError(path, "damaged", f"{ASKED}: names of scans by stage", "delete it")
    if not isinstance(folder, str) or "\0" in folder:
        raise OutputError(path, "damaged", "scans: the folder they came from", "delete it")
    return record


def _are_names(stems: object) -> bool:
    return isinstance(stems, list) and all(isinstance(stem, str) for stem in stems)


def asked_for(out: Path, sequence: str) -> dict[str, set[str]]:
    """Return the stems of the scans that each stage was asked for; without stages not recorded."""
    record = _record(out / "sequences" / sequence / SOURCE)
    return {stage: set(stems) for stage, stems in record.get(ASKED, {}).items()}


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
    recorded = _record(out / "sequences" / sequence / SOURCE).get("scans")
    if dataset is None and recorded and is_folder(Path(recorded)):
        return find_scans(Path(recorded))
    root = dataset or usual
    if (root / "sequences").is_dir():
        return find_scans(root, [sequence])
    raise NoInputError(
        out / "sequences" / sequence,
        f"its scans are not in {shortened(str(dataset or recorded or root.absolute()), LONGEST)}",
        "the folder that they came from",
        "give with --dataset the folder that holds sequences/",
    )
