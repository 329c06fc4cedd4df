# SPDX-License-Identifier: MIT
import csv
import io
from dataclasses import asdict
from pathlib import Path

from salsanext_cli.labelling.scan_choice import Choice
from salsanext_cli.report.picked import picked_csv, picked_scans
from salsanext_cli.results.paths import ScanFile

FILES = [ScanFile("$0$", f"[{i}]", Path(f"/s/[{i}].bin")) for i in range(3)]
CHOICES = [Choice(2, 0.5, 1), Choice(0, 0.25, 3, 1.25, 2), Choice(1, 0.375, 2, 0.0, 0)]
PICKED = picked_scans(CHOICES, FILES)


def test_the_csv_file_holds_every_value():
    rows = list(csv.DictReader(io.StringIO(picked_csv(PICKED).decode())))
    empty = {key: "" if value is None else str(value) for key, value in asdict(PICKED[0]).items()}
    assert rows[0] == empty
    assert float(rows[1]["distance"]) == 1.25
