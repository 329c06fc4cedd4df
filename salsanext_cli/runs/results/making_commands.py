# SPDX-License-Identifier: MIT
"""Commands that make the results of scans, for hints about results that are missing."""

PREDICT = "run `salsanext predict {scans} {out}` first"
UNCERTAINTY_STAGE = "run `salsanext uncertainty {scans} {out}` first"
FUSE = "run `salsanext fuse {out}` first"
PREDICT_ERROR = (
    "run `salsanext predict {scans} {out} --error` with the default weights "
    "or weights of `salsanext tune error`"
)
MADE_BY = {
    "error": PREDICT_ERROR,
    "epistemic": UNCERTAINTY_STAGE,
    "aleatoric": UNCERTAINTY_STAGE,
    "total": UNCERTAINTY_STAGE,
    "entropy": UNCERTAINTY_STAGE,
    "mutual_information": UNCERTAINTY_STAGE,
    "least_confidence": PREDICT,
    "disagreement": FUSE,
}
"""Hint, by kind of uncertainty, for an output folder ``out`` of ``scans`` without it."""
