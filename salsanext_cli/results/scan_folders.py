# SPDX-License-Identifier: MIT
"""Files of a folder: those that are scans there, and those that are passed over."""

import logging
import os
from collections.abc import Collection, Iterable
from pathlib import Path

from salsanext_cli.errors import NOTICE, NoInputError, first_few
from salsanext_cli.files.reading import is_folder, present
from salsanext_cli.formats import CLOUD_SUFFIXES, SCAN_SUFFIXES, TABLE_SUFFIXES, scan_suffix
from salsanext_cli.formats.recordings.address import is_recording

MAX_LINE_BYTES = 200
COMPANIONS = (".label", ".toml", ".yaml", ".md")
"""Suffixes of files that are known to lie beside scans."""

OWN_TABLES = {
    "scores.txt": b"accuracy_mean:",
    "log.csv": b"epoch,learning_rate,",
    "picked.csv": b"rank,sequence,scan,",
}
"""Names of the tables that `eval`, `train` and `pick` write, and how the first line of each begins.

Lines that are a comment do not count.
"""

log = logging.getLogger(__name__)


def names_in(folder: Path) -> list[str]:
    """Return the names of everything in a folder but folders and what is hidden."""
    # Not is_file(): a link to a scan that is gone must fail when read, not be passed over.
    with os.scandir(folder) as entries:
        return [e.name for e in entries if not e.name.startswith(".") and not is_folder(e)]


def is_own_table(path: Path) -> bool:
    """Return whether a file is a table that `eval`, `train` or `pick` has written."""
    if (beginning := OWN_TABLES.get(path.name)) is None or not path.is_file():
        return False
    try:
        with path.open("rb") as file:
            lines = (file.readline(MAX_LINE_BYTES) for _ in range(2))
            line = next((line for line in lines if not line.startswith(b"#")), b"")
    except OSError:
        # Who reads it as a scan says why that fails.
        return False
    return line.startswith(beginning)


def suffixes_of_scans(found: Collection[str]) -> tuple[str, ...]:
    """Return the suffixes, of those that `scan_suffix` found in a folder, of the scans in it.

    Tables are often something else: they count where there are no clouds, and of one kind only.
    """
    if any(suffix in CLOUD_SUFFIXES for suffix in found):
        return CLOUD_SUFFIXES
    return next(((suffix,) for suffix in TABLE_SUFFIXES if suffix in found), ())


def require_known(path: Path) -> None:
    """Raise `NoInputError` for a file that is there and of no format of scans."""
    if present(path) and not scan_suffix(path.name):
        raise NoInputError(
            path,
            f"a {path.suffix} file, which is not read" if path.suffix else "has no suffix",
            f"one of {', '.join(SCAN_SUFFIXES)}",
            "convert it to .ply or .las, with CloudCompare or PDAL for example",
        )


def log_passed_over(source: Path, folders: Iterable[Path], scans: Collection[str]) -> None:
    """Log how many files of folders are passed over, by suffix; in detail their names.

    `source`: subject of the message; `folders`: folders of scans; `scans`: file names of the scans.
    """
    left = []
    for folder in folders:
        with os.scandir(folder) as entries:
            # Of a million names nearly all are those of scans and their labels.
            others = [e for e in entries if e.name not in scans and not e.name.startswith(".")]
            others = [e for e in others if not e.name.lower().endswith(COMPANIONS)]
            left += [folder / e.name for e in others if not is_folder(e)]
    if left:
        log.log(NOTICE, "%s: passed over %s", source, counted_by_suffix(left))
    for suffix, paths in _by_suffix(left).items():
        log.info("passed over, %s: %s", suffix, first_few(paths))


def counted_by_suffix(paths: Iterable[Path]) -> str:
    """Return the numbers of files by suffix, in words."""
    return ", ".join(f"{len(group)} {suffix}" for suffix, group in _by_suffix(paths).items())


def _by_suffix(paths: Iterable[Path]) -> dict[str, list[Path]]:
    groups: dict[str, list[Path]] = {}
    for path in sorted(paths, key=os.fspath):
        groups.setdefault(path.suffix.lower(), []).append(path)
    return {suffix or "without a suffix": groups[suffix] for suffix in sorted(groups)}


def nothing_in(source: Path, others: list[Path]) -> NoInputError:
    """Return the error of a source without scans, which says what else it holds."""
    expected = f"{', '.join(SCAN_SUFFIXES)} files, or sequences/*/velodyne"
    inside = sorted(filter(is_recording, source.iterdir())) if source.is_dir() else []
    if inside:
        found = f"holds no scans, but recordings: {first_few([each.name for each in inside])}"
        return NoInputError(source, found, expected, f"give one of these: {inside[0]}")
    found = f"holds no scans{f', but {counted_by_suffix(others)}' if others else ''}"
    return NoInputError(source, found, f"{expected}, or a recording")
