# SPDX-License-Identifier: MIT
"""Results in merged classes, which have no probability of error."""

from __future__ import annotations

import os
import shlex
from contextlib import suppress
from pathlib import Path

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import SalsanextError
from salsanext_cli.core.wording import command, setting
from salsanext_cli.io.files.reading import fingerprint
from salsanext_cli.io.label_spaces import label_space
from salsanext_cli.io.weights.card_file import default_weights, read_card
from salsanext_cli.runs.results.paths import ERROR

OTHER_FOLDER = "-error"  # Ending of the folder that a hint suggests


def are_merged(space: LabelSpace | None, weights: str | None) -> bool:
    """Return whether labels are in merged classes, as far as that is known.

    Parameters
    ----------
    space : LabelSpace, optional
        Recorded classes of the labels.
    weights : str, optional
        Recorded SHA-256 of the weights; the classes of others than the default weights are unknown.

    Returns
    -------
    bool
    """
    if space is None:
        return False
    if space.fits(label_space("coarse")):
        return True
    # An installation without its weights still shows results.
    with suppress(SalsanextError):
        path = default_weights()
        return weights == fingerprint(path) and not space.fits(read_card(path).space)
    return False


def unmerged_error_hint(out: Path, scans: str) -> str:
    """Return the hint that makes a probability of error for the scans of merged results.

    `scans`: the scans as words of a command line.
    """
    other = shlex.quote(f"{os.path.normpath(out)}{OTHER_FOLDER}")
    predict = command(f"salsanext predict {scans} {other}", setting("extras", (ERROR,)))
    remedy = f"run `{predict}`, then give {other}"
    return f"the error belongs to the classes of the weights: {remedy}"
