# SPDX-License-Identifier: MIT
"""Consecutive scans of a sequence, which a guarantee counts as if they were independent."""

import re
from collections.abc import Sequence

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.texts import counted
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.summary.scan_warnings import ScanWarning

"""Code of the warning."""
MAX_SHARE = 0.5  # Largest share of stretches among the scans at which there is a warning
LEAST_TIME = 10**12  # Numbers from here on are times in the name: ms, µs or ns
SECOND = {13: 10**3, 14: 10**3, 16: 10**6, 17: 10**6, 18: 10**9, 19: 10**9}
"""One second in the unit of a time, by its number of digits."""


def stretches(files: Sequence[ScanFile]) -> int:
    """Return the number of stretches of consecutive scans.

    A scan continues a stretch if it follows another one of its sequence: the number at the end of
    its name is the next one, or a time at most a second later.
    """
    count = 0
    last: tuple[str, int] | None = None
    for sequence, number in sorted((file.sequence, _number(file)) for file in files):
        follows = last is not None and sequence == last[0] and _follows(last[1], number)
        count += not follows
        last = sequence, number
    return count


def _number(file: ScanFile) -> int:
    """Return the number at the end of a name, -1 without one."""
    digits = re.search(r"[0-9]+$", file.stem)
    return int(digits[0]) if digits else -1


def _follows(before: int, number: int) -> bool:
    if min(before, number) < 0:
        return False
    step = SECOND.get(len(str(number)), 1) if number >= LEAST_TIME else 1
    return 0 < number - before <= step


def consecutive_warning(files: Sequence[ScanFile], drives_needed: int) -> ScanWarning | None:
    """Return a warning if most scans follow others, None else.

    Parameters
    ----------
    files : sequence of ScanFile
        Scans that each count as one unit of a guarantee.
    drives_needed : int
        Number of drives from which on each drive is a unit instead.

    Returns
    -------
    ScanWarning or None
    """
    count = stretches(files)
    if count > MAX_SHARE * len(files):
        return None
    sequences = sorted({file.sequence for file in files})
    scans = f"{counted(len(files), 'scan')} of {counted(len(sequences), 'sequence')}"
    runs = "one stretch" if count == 1 else f"{count:,} stretches"
    message = (
        f"{scans} form {runs} of consecutive scans, which are alike, but the bound counts every "
        "scan as independent, so it may guarantee less than it states"
    )
    hint = (
        f"label scans that are drawn from whole drives, or scans of {drives_needed} drives, each "
        "of which then counts once"
    )
    return ScanWarning(code=WarningCode.CONSECUTIVE, message=message, hint=hint, scans=sequences)
