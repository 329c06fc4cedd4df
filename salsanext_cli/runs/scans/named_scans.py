# SPDX-License-Identifier: MIT
"""Scans by name: on the command line, and in the list of tagged scans that a page exports."""

from collections.abc import Iterable, Sequence
from pathlib import Path

from salsanext_cli.core.errors import FormatError, UsageError
from salsanext_cli.core.texts import did_you_mean, first_few
from salsanext_cli.io.files.listed_lines import listed_lines
from salsanext_cli.runs.scans.scan_file import ScanFile

EXAMPLE = "one name per line, such as 08/000000"


def named_scans(names: Iterable[str], files: Sequence[ScanFile], subject: str) -> list[ScanFile]:
    """Return the scans of some names, in their order, without repetitions.

    Parameters
    ----------
    names : iterable of str
        Names such as ``08/000000``, or stems that only one sequence has.
    files : sequence of ScanFile
        Scans to choose from.
    subject : str
        Option or file with the names, for errors.

    Returns
    -------
    list of ScanFile

    Raises
    ------
    UsageError
        If no scan or several scans have a name.
    """
    holders: dict[str, list[ScanFile]] = {}
    for file in files:
        for name in {file.name, file.stem}:
            holders.setdefault(name, []).append(file)
    chosen: dict[ScanFile, None] = {}
    for name in names:
        matches = [file.name for file in holders.get(name, ())]
        if len(matches) != 1:
            count = f"{len(matches)} scans have" if matches else "no scan has"
            expected = f"names such as {first_few(matches or [file.name for file in files])}"
            hint = "" if matches else did_you_mean(name, holders)
            raise UsageError(subject, f"{name}: {count} this name", expected, hint)
        chosen[holders[name][0]] = None
    return [*chosen]


def read_names(path: Path) -> list[str]:
    """Return the names of scans in a text file: one per line; lines with # are comments.

    Raises `FormatError` if the file has none or is no text.
    """
    names = [line.text for line in listed_lines(path, EXAMPLE)]
    if not names:
        raise FormatError(path, "contains no name of a scan", EXAMPLE)
    return names
