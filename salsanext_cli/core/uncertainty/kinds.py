# SPDX-License-Identifier: MIT
"""Kinds of uncertainty of points, in the order of lists."""

from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class UncertaintyKind:
    """Kind of uncertainty of points."""

    title: str  # Title of pictures
    unit: str = ""
    most: float = float("inf")  # Largest possible value


UNCERTAINTY = {
    "error": UncertaintyKind(title="error: probability that the label is wrong", most=1.0),
    "epistemic": UncertaintyKind(title="epistemic uncertainty"),
    "aleatoric": UncertaintyKind(title="aleatoric uncertainty"),
    "total": UncertaintyKind(title="total uncertainty"),
    "entropy": UncertaintyKind(title="uncertainty: entropy of the classes", unit="nats"),
    "mutual_information": UncertaintyKind(title="uncertainty: mutual information", unit="nats"),
    "least_confidence": UncertaintyKind(title="uncertainty: 1 − the largest probability", most=1.0),
    "disagreement": UncertaintyKind(
        title="disagreement: share of the scans against the label", most=1.0
    ),
}
DEFAULT_UNCERTAINTIES = ("entropy", "disagreement", "least_confidence")
"""Kinds that "uncertainty" stands for without the error; the first available one counts."""
