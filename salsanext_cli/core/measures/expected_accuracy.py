# SPDX-License-Identifier: MIT
"""Estimated accuracy of a run without labels, from the mean confidence of its scans.

There is no estimate for:

- weights without a line: of a published checkpoint, or of a training that inherited none
- labels of pixels and labels of `fuse`: the line is of the points of single scans
- a run that rejects labels: the accuracy of the accepted ones is unknown
- scans of earlier runs, in a summary; a report reads their confidence from files

It is withheld, with the codes as reasons, for:

- a scan with a warning whose code `withholds_estimate`
- all scans of a folder if one of them, in this or an earlier run, has a warning of `OF_RUN`

Merged classes have the same estimate: it held for coarse ones (docs/experiments/guarantee.md).
"""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping
from dataclasses import dataclass

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.network.card import AccuracyLine
from salsanext_cli.core.texts import counted

OF_RUN = (WarningCode.MIXED_SENSORS,)
"""Warnings that withhold the estimate of the whole run: its fit suits none of the sensors."""
WITHHELD_FOR = tuple(code for code in WarningCode if code.withholds_estimate)
"""Warnings that a scan is unlike the judged drives; those of `OF_RUN` withhold all scans."""
EDGE = 1e-6  # Mean confidences closer to 0 or 1 have no useful logit


@dataclass(frozen=True, slots=True, kw_only=True)
class ExpectedAccuracy:
    """Estimated accuracy of some scans of a run, or the warnings that forbid an estimate."""

    accuracy: float | None  # Share of the points, 0…1; None if the estimate is withheld
    interval: tuple[float, float] | None  # Held for the 14 excerpts of drives that set it, 0…1
    scans: int  # Number of scans that the estimate covers
    withheld: Mapping[str, int]  # Number of other scans by code of the warning

    @property
    def text(self) -> str:
        """One line for the summary of a run."""
        reasons = ", ".join(
            f"{code} in {counted(count, 'scan')}" for code, count in self.withheld.items()
        )
        if self.interval is None:
            return f"Accuracy not estimated: {reasons}"
        low = math.floor(100 * self.interval[0])
        high = math.ceil(100 * self.interval[1])
        others = f"; not estimated for the others: {reasons}" if reasons else ""
        scans = f" of {counted(self.scans, 'scan')}" if reasons else ""
        source = f"from confidence, without labels{others}"
        return f"Estimated accuracy{scans}: {low} to {high} % ({source})"


def expected_accuracy(
    line: AccuracyLine | None,
    confidences: Mapping[str, float],
    warnings: Mapping[str, Collection[str]],
) -> ExpectedAccuracy | None:
    """Estimate the accuracy of a run by a line through logits of confidence and accuracy.

    Parameters
    ----------
    line : AccuracyLine, optional
        Line of the weights.
    confidences : mapping of str to float
        Mean of the largest probabilities of each scan's points, 0…1, by name of the scan.
    warnings : mapping of str to collection of str
        Names of scans by code. Those of `OF_RUN` count if they concern other scans of the folder.

    Returns
    -------
    ExpectedAccuracy or None
        None without a line or scans.
    """
    if line is None or not confidences:
        return None
    withheld: dict[str, set[str]] = {code: {*warnings.get(code, ())} for code in WITHHELD_FOR}
    for code in withheld.keys() - {*OF_RUN}:
        withheld[code] &= confidences.keys()
    counts = {code: len(names) for code, names in sorted(withheld.items()) if names}
    if any(code in counts for code in OF_RUN):
        return ExpectedAccuracy(accuracy=None, interval=None, scans=0, withheld=counts)
    unlike = {name for names in withheld.values() for name in names}
    covered = [confidence for name, confidence in confidences.items() if name not in unlike]
    if not covered:
        return ExpectedAccuracy(accuracy=None, interval=None, scans=0, withheld=counts)
    # Rounded, since the order of the scans is that of the workers.
    mean = min(max(round(math.fsum(covered) / len(covered), 6), EDGE), 1 - EDGE)
    logit = line.slope * math.log(mean / (1 - mean)) + line.offset
    accuracy = (1 + math.tanh(logit / 2)) / 2  # The logistic function, without overflow
    interval = (round(max(accuracy - line.margin, 0), 4), round(min(accuracy + line.margin, 1), 4))
    return ExpectedAccuracy(
        accuracy=round(accuracy, 4), interval=interval, scans=len(covered), withheld=counts
    )
