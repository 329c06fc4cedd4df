# SPDX-License-Identifier: MIT
"""Picture of a fit of `tune risk`."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from salsanext_cli.report.risk_curve import risk_curve_picture

if TYPE_CHECKING:
    # It imports torch, which takes a second.
    from salsanext_cli.training.tuning.risk_report import RiskFit


def risk_picture(fit: RiskFit) -> bytes:
    """Draw the accepted and the wrong points of a fit as a PNG."""
    scans = [(scan.share_accepted, scan.share_wrong) for scan in fit.scans]
    held_out = [(sequence.accepted, sequence.loss) for sequence in fit.held_out]
    return risk_curve_picture(
        fit.threshold,
        fit.curve.accepted,
        fit.curve.wrong,
        np.array(scans).reshape(-1, 2),
        np.array(held_out).reshape(-1, 2),
    )
