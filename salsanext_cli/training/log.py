# SPDX-License-Identifier: MIT
"""Log of a training."""

import csv
import io
from collections.abc import Sequence
from pathlib import Path

from salsanext_cli.results.owned_folder import OwnedFolder

Row = dict[str, float]
"""One epoch: epoch, learning_rate, loss, seconds; if validated, also what `validate` returns."""


def write_log(path: Path, rows: Sequence[Row]) -> None:
    """Write one line per epoch as CSV; cells without a measurement are empty."""
    text = io.StringIO()
    columns = dict.fromkeys(key for row in rows for key in row)
    table = csv.DictWriter(text, columns, lineterminator="\n")
    table.writeheader()
    table.writerows({key: _cell(value) for key, value in row.items()} for row in rows)
    OwnedFolder(path.parent).write(path, text.getvalue().encode())


def _cell(value: float) -> str:
    if value != value:
        return ""
    return str(value) if isinstance(value, int) else f"{value:.6g}"
