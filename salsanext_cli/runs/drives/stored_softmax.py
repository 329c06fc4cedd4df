# SPDX-License-Identifier: MIT
"""Softmax of the points of a scan in an output folder, or their votes."""

from pathlib import Path

import numpy as np

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import FormatError
from salsanext_cli.core.fusion.top_classes import STORED, softmax_of
from salsanext_cli.core.records import Float
from salsanext_cli.core.wording import setting
from salsanext_cli.io.files.reading import present
from salsanext_cli.io.formats.npy import read_array, read_probabilities
from salsanext_cli.runs.results.output_paths import output_path
from salsanext_cli.runs.scans.scan_file import ScanFile


def stored_softmax(out: Path, file: ScanFile, count: int, space: LabelSpace) -> Float:
    """Read the softmax (N, C) float32 of the points of a scan, or their votes, of `predict`."""
    path = output_path(out, file.sequence, "probabilities", file.stem)
    if present(path):
        return read_probabilities(path, count, space.class_count).astype(np.float32)
    votes = output_path(out, file.sequence, "votes", file.stem)
    packed = read_array(votes, "uint16", (count, min(STORED, space.class_count)))
    if (highest := (packed >> 8).max(initial=0)) >= space.class_count:
        expected = f"0 to {space.class_count - 1}, the classes of {space.name}"
        hint = f"predict again with {setting('extras', ('votes',))}"
        raise FormatError(votes, f"has class {highest}", expected, hint)
    return softmax_of(packed, space.class_count)
