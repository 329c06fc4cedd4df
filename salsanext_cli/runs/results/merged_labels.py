# SPDX-License-Identifier: MIT
"""Labels in merged classes, which have no probability of error."""

from __future__ import annotations

import os
import shlex
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import default_weights, read_card
from salsanext_cli.runs.results.making_commands import PREDICT_UNMERGED_ERROR
from salsanext_cli.runs.scans.scan_file import ScanFile

SUFFIX_OF_FOLDER = "-error"  # What a hint appends to the name of the output folder


def are_in_merged_classes(space: LabelSpace | None, weights_sha256: str | None) -> bool:
    """Return whether labels are in merged classes, as far as that is known.

    Parameters
    ----------
    space : LabelSpace, optional
        Recorded classes of the labels.
    weights_sha256 : str, optional
        Recorded SHA-256 of the weights. The classes of other weights than the default ones are
        unknown.

    Returns
    -------
    bool
    """
    if space is None:
        return False
    if space.fits(label_space("coarse")):
        return True
    try:
        weights = default_weights()
        is_default = weights_sha256 == fingerprint(weights)
        return is_default and not space.fits(read_card(weights).space)
    except SalsanextError:  # An installation without its weights still shows results.
        return False


def hint_for_error(out: Path, file: ScanFile) -> str:
    """Return the hint that gives scans with merged labels a probability of error.

    Parameters
    ----------
    out : Path
        Output folder with the merged labels.
    file : ScanFile
        One of the scans.

    Returns
    -------
    str
    """
    folder = Path(f"{os.path.normpath(out)}{SUFFIX_OF_FOLDER}")
    predict = PREDICT_UNMERGED_ERROR.text(out, [file], target=folder)
    remedy = f"run `{predict}`, then give {shlex.quote(str(folder))}"
    return f"the error belongs to the classes of the weights: {remedy}"
