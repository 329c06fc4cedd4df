# SPDX-License-Identifier: MIT
"""Commands of salsanext, for the scripts that measure with them."""

import json
import subprocess
from pathlib import Path
from typing import Any

from salsanext_cli.runs.scans.scan_file import ScanFile


def salsanext(*words: object) -> dict[str, Any]:
    """Run a command and return its JSON object."""
    command = ["salsanext", *map(str, words), "--json", "--quiet"]
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE)
    found: dict[str, Any] = json.loads(done.stdout)
    return found


def link(file: ScanFile, sequence: Path) -> None:
    """Make links to a scan and its labels in a sequence."""
    for path in (file.path, file.label_path):
        place = sequence / path.parent.name / f"{file.sequence}-{path.name}"
        place.parent.mkdir(parents=True, exist_ok=True)
        if not place.is_symlink():
            place.symlink_to(path.resolve())
