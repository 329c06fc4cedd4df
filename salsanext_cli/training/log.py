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
    for row in rows:
        # NaN is no measurement.
        table.writerow({k: f"{value:.6g}" for k, value in row.items() if value == value})
    OwnedFolder(path.parent).write(path, text.getvalue().encode())
