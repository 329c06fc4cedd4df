# SPDX-License-Identifier: MIT
"""Names of sequences that earlier results of the same scans have in an output folder."""

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

from salsanext_cli.runs.results.manifest import Manifest, ScanSource
from salsanext_cli.runs.scans.layouts import layout_of
from salsanext_cli.runs.scans.scan_file import ScanFile


def with_recorded_names(scans: Iterable[ScanFile], out: Path) -> list[ScanFile]:
    """Return scans in the sequences under which an output folder has them, sorted.

    Names depend on the folder that was given and on the version. With other names, a repeated run
    would compute all results again, in other folders.

    Parameters
    ----------
    scans : iterable of ScanFile
        Scans as `find_scans` names them.
    out : Path
        Output folder, which may not exist.

    Returns
    -------
    list of ScanFile
    """
    recorded: dict[str, dict[str, ScanSource]] = {}
    for sequence, source in Manifest(out).sources().items():
        recorded.setdefault(source.folder, {})[sequence] = source
    return sorted(_as_recorded(scan, recorded.get(str(scan.path.parent), {})) for scan in scans)


def _as_recorded(scan: ScanFile, recorded: dict[str, ScanSource]) -> ScanFile:
    """Return a scan in the recorded sequence of its folder that contains it."""
    if scan.sequence in recorded:
        return scan
    containing = [name for name, source in recorded.items() if scan.stem in source.suffixes]
    if not containing:
        layout = layout_of(scan.path.parent, [scan.path.name])
        has_drives = layout is not None and bool(layout.drive(scan.stem))
        # A scan that was added to the folder of a drive belongs to this drive.
        containing = [] if has_drives else [*recorded]
    return replace(scan, sequence=containing[0]) if len(containing) == 1 else scan
