# SPDX-License-Identifier: MIT
"""Estimate of uncertainty, however it is made."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from salsanext_cli.records import Double, Float


@dataclass(frozen=True, slots=True)
class Uncertainty:
    """Uncertainty of the pixels of one scan, (H, W) float32 each."""

    # Variance of the softmax over passes, mean over classes (paper III-C.2); 0…(1 - 1/C)/C
    epistemic: Float
    entropy: Float  # Of the mean softmax, in nats; 0…ln C
    mutual_information: Float  # `entropy` minus the mean entropy of the passes in nats; 0…ln C
    # Variance of the softmax by the sensor's noise, mean over classes; 0…(1 - 1/C)/C. It ranks
    # points; its scale is far too small
    aleatoric: Float | None = None

    @property
    def total(self) -> Float | None:
        """Epistemic plus aleatoric, if that is known (paper III-C)."""
        return None if self.aleatoric is None else self.epistemic + self.aleatoric


@dataclass(frozen=True, slots=True)
class Estimate:
    """Mean and spread of the softmax under dropout."""

    probabilities: Float  # (C, H, W) float32: mean softmax: the prediction
    variance: Float  # (C, H, W) float32: variance of the softmax, of each class
    uncertainty: Uncertainty  # Every pixel's, occupied or not

    @classmethod
    def of(cls, mean: Double, variance: Double, total: Double, information: Double) -> Estimate:
        """Gather mean and variance (C, H, W), entropy and mutual information (H, W), float64."""
        return cls(
            probabilities=mean.astype(np.float32),
            variance=variance.astype(np.float32),
            uncertainty=Uncertainty(
                epistemic=variance.mean(axis=0).astype(np.float32),
                entropy=total.astype(np.float32),
                mutual_information=information.astype(np.float32),
            ),
        )
