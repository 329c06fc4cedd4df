# SPDX-License-Identifier: MIT
"""How far probabilities and uncertainties can be trusted: that part of an evaluation."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from salsanext_cli.classes import LabelSpace
from salsanext_cli.measures.figures import (
    CalibrationFigures,
    UncertaintyFigures,
    calibration_figures,
    uncertainty_figures,
)
from salsanext_cli.measures.uncertainty_counts import (
    CLASS,
    FOLDERS,
    KINDS,
    RING,
    UncertaintyCounts,
)

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class UncertaintyEvaluation:
    """What was found beside the predictions, and how far it can be trusted.

    Attributes
    ----------
    space : LabelSpace
        Which classes there are.
    calibration : CalibrationFigures or None
        Of the probabilities; None without any.
    uncertainty : dict of str to UncertaintyFigures
        By kind; empty without any.
    """

    space: LabelSpace
    calibration: CalibrationFigures | None
    uncertainty: dict[str, UncertaintyFigures]

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON, without what there is none of; null stands for NaN."""
        plain: dict[str, Any] = {}
        if self.calibration:
            plain["calibration"] = self.calibration.to_dict(self.space)
        if self.uncertainty:
            kinds = self.uncertainty.items()
            plain["uncertainty"] = {kind: figures.to_dict(self.space) for kind, figures in kinds}
        return plain

    def write_pictures(self, out: Path) -> None:
        """Draw what there is into the output folder."""
        from salsanext_cli.report.uncertainty_plots import (
            class_uncertainty,
            reliability_diagram,
            risk_coverage,
            sparsification,
        )

        if self.calibration:
            reliability_diagram(out / "eval_reliability.png", self.calibration)
        if self.uncertainty:
            risk_coverage(out / "eval_risk_coverage.png", self.uncertainty)
            sparsification(out / "eval_sparsification.png", self.uncertainty)
        if epistemic := self.uncertainty.get("epistemic"):
            class_uncertainty(out / "eval_class_uncertainty.png", epistemic, self.space)


def trust(counts: UncertaintyCounts, scans: int, space: LabelSpace) -> UncertaintyEvaluation:
    """Divide the counts, and say which files are there for some of the scans only.

    Parameters
    ----------
    counts : UncertaintyCounts
        Of all scans.
    scans : int
        How many scans that is.
    space : LabelSpace
        Which classes there are.
    """
    for folder in FOLDERS:
        if 0 < counts.files[folder] < scans:
            log.warning("%s of %d of %d scans only", folder, counts.files[folder], scans)
    by_class = counts.calibrations.get(CLASS)
    by_ring = counts.calibrations.get(RING)
    return UncertaintyEvaluation(
        space=space,
        calibration=calibration_figures(by_class, by_ring, space) if by_class else None,
        uncertainty={
            kind: uncertainty_figures(found, counts.rankings.get((kind, RING)), space)
            for kind in KINDS
            if (found := counts.rankings.get((kind, CLASS)))
        },
    )
