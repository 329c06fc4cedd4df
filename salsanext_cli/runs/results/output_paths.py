# SPDX-License-Identifier: MIT
"""Paths of results in an output folder, by scan and folder."""

from collections.abc import Iterable
from pathlib import Path

from salsanext_cli.core.errors import OutputError
from salsanext_cli.io.files.reading import present
from salsanext_cli.runs.results.folder_names import SUFFIX_OF_FOLDER
from salsanext_cli.runs.scans.scan_file import ScanFile


def output_path(out: Path, sequence: str, folder: str, stem: str) -> Path:
    """Return the path of the result of a scan in a folder, a key of `SUFFIX_OF_FOLDER`."""
    for name in (sequence, stem):
        if name in ("", ".", "..") or "\0" in name or Path(name).name != name:
            raise OutputError(repr(name), "is no file name", "a plain name without slashes")
    return out / "sequences" / sequence / folder / f"{stem}{SUFFIX_OF_FOLDER[folder]}"


def find_outputs(out: Path, folder: str) -> dict[tuple[str, str], Path]:
    """Return the results in a folder of all sequences, by sequence and stem, sorted."""
    if not present(out / "sequences"):
        return {}
    suffix = SUFFIX_OF_FOLDER[folder]
    paths = {
        (sequence.name, path.name.removesuffix(suffix)): path
        for sequence in (out / "sequences").glob("*")
        for path in (sequence / folder).glob(f"[!.]*{suffix}")
    }
    return dict(sorted(paths.items()))


def with_outputs(scans: Iterable[ScanFile], out: Path, *folders: str) -> list[ScanFile]:
    """Return the scans that have a result in one of some folders of an output folder."""
    keys = {key for name in folders for key in find_outputs(out, name)}
    return [scan for scan in scans if (scan.sequence, scan.stem) in keys]
