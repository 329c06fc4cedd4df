# SPDX-License-Identifier: MIT
"""Comparison of the guarantee of a run with labels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.accepted_labels import AcceptedCounts
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.runs.results.owned_folder import OwnedFolder
from salsanext_cli.runs.results.provenance import Provenance
from salsanext_cli.runs.summary.threshold_scans import why_incomparable


def guarantee_of_run(
    out: Path, space: LabelSpace, losses: Mapping[str, AcceptedCounts]
) -> RiskBoundCheck | None:
    """Compare the guarantee of a run with labels; None if the run has none.

    Parameters
    ----------
    out : Path
        Output folder of `predict --reject risk`.
    space : LabelSpace
        Classes of the labels.
    losses : mapping of str to AcceptedCounts
        Points of each scan by name.

    Returns
    -------
    RiskBoundCheck or None
    """
    findings = OwnedFolder(out, "predict").findings()
    codes = {finding.code for name in losses for finding in findings.get(name, ())}
    threshold = Provenance(out).risk_threshold(space)
    check = RiskBoundCheck.from_scans(
        threshold, losses, are_others=WarningCode.OTHER_SCANS in codes
    )
    if check is None or threshold is None:
        return None
    return replace(check, incomparable=why_incomparable(threshold, check.units))
