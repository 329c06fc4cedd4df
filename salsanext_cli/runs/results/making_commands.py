# SPDX-License-Identifier: MIT
"""Commands that make the results of scans, for hints about results that are missing."""

from salsanext_cli.core.wording import command, setting
from salsanext_cli.runs.results.paths import ERROR

PREDICT = "run `salsanext predict {scans} {out}` first"
UNCERTAINTY_STAGE = "run `salsanext uncertainty {scans} {out}` first"
FUSE = "run `salsanext fuse {out}` first"
MADE_BY = {
    "epistemic": UNCERTAINTY_STAGE,
    "aleatoric": UNCERTAINTY_STAGE,
    "total": UNCERTAINTY_STAGE,
    "entropy": UNCERTAINTY_STAGE,
    "mutual_information": UNCERTAINTY_STAGE,
    "disagreement": FUSE,
}
"""Hint by kind of uncertainty; labels and their confidence are made by `PREDICT`."""


def made_by(column: str) -> str:
    """Return the hint for an output folder ``out`` of ``scans`` without a kind of uncertainty."""
    if column == "error":
        predict = command("salsanext predict {scans} {out}", setting("extras", (ERROR,)))
        weights = "the default weights or weights of `salsanext tune error`"
        return f"run `{predict}` with {weights}"
    return MADE_BY.get(column, PREDICT)
