# SPDX-License-Identifier: MIT
"""Estimates of the uncertainty of a prediction."""

from __future__ import annotations

from dataclasses import dataclass

from salsanext_cli.records import Float


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Uncertainty of the pixels of one scan, (H, W) float32.

    Attributes
    ----------
    epistemic
        Variance of the softmax over passes, mean over classes (paper III-C.2); 0…(1 - 1/C)/C.
    entropy
        Entropy of the mean softmax in nats; 0…ln C.
    mutual_information
        `entropy` minus the mean entropy of the passes in nats; 0…ln C.
    aleatoric, optional
        Variance of the softmax by the noise of the sensor, mean over classes; 0…(1 - 1/C)/C. It
        ranks points; its scale is far too small.
    """

    epistemic: Float
    entropy: Float
    mutual_information: Float
    aleatoric: Float | None = None

    @property
    def total(self) -> Float | None:
        """Epistemic plus aleatoric uncertainty, if both are estimated (paper III-C)."""
        return None if self.aleatoric is None else self.epistemic + self.aleatoric


@dataclass(frozen=True, slots=True)
class Estimate:
    """Mean and variance of the softmax under dropout, (C, H, W) float32, and the uncertainty.

    The mean softmax `probabilities` is the prediction. Empty pixels have values too.
    """

    probabilities: Float
    variance: Float
    uncertainty: Uncertainty
