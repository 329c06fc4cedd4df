# SPDX-License-Identifier: MIT
"""Finding of a check: a reason to doubt the labels of a scan."""

from typing import NamedTuple


class Finding(NamedTuple):
    """Reason to doubt the labels of a scan."""

    code: str  # Name of the check, as in docs/reference/warnings.md
    problem: str
    hint: str
