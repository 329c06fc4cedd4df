# SPDX-License-Identifier: MIT
"""What comparing predictions with labels gives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from salsanext_cli import __version__
from salsanext_cli.classes import LabelSpace
from salsanext_cli.measures.confusion import Confusion
from salsanext_cli.measures.scores import Scores
from salsanext_cli.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.parallel.run import Failure
from salsanext_cli.storage.sources import MissingResults


@dataclass(frozen=True, slots=True)
class Evaluation:
    """The result of comparing predictions with labels.

    Attributes
    ----------
    space : LabelSpace
        Whose classes were compared.
    confusion : Confusion
        The counts that the scores come from.
    scores : Scores
        Over all points.
    by_distance : dict of str to Scores
        By name of the ring; empty if not wanted.
    unknown_truth, unknown_predictions : dict of int to int
        How often raw ids occur that the label space does not know; taken as unlabelled.
    scans : int
        Number of scans compared.
    absent : MissingResults
        Scans without predictions, left out.
    failures : tuple of Failure
        Scans that could not be compared, left out.
    settings : dict
        What was chosen and who made the predictions.
    trust : Trust
        How far probabilities and uncertainties can be trusted, if there are any.
    """

    space: LabelSpace
    confusion: Confusion
    scores: Scores
    by_distance: dict[str, Scores]
    unknown_truth: dict[int, int]
    unknown_predictions: dict[int, int]
    scans: int
    absent: MissingResults
    failures: tuple[Failure, ...]
    settings: dict[str, Any]
    trust: UncertaintyEvaluation

    def to_dict(self) -> dict[str, Any]:
        """Return plain data for JSON; null stands for NaN."""
        return {
            "stage": "eval",
            "version": __version__,
            "settings": self.settings,
            "label_space": self.space.name,
            "scans": self.scans,
            "missing": [str(scan.path) for scan in self.absent.missing],
            "not_asked_for": self.absent.not_asked_for,
            "failures": [
                {"scan": str(failure.scan.path), "reason": failure.reason}
                for failure in self.failures
            ],
            "unknown_ids": {
                "truth": {str(i): count for i, count in self.unknown_truth.items()},
                "predictions": {str(i): count for i, count in self.unknown_predictions.items()},
            },
            "scores": self.scores.to_dict(),
            "by_distance": {name: ring.to_dict() for name, ring in self.by_distance.items()},
            "classes": list(self.space.names),
            "confusion": self.confusion.matrix.tolist(),
            **self.trust.to_dict(),
        }
