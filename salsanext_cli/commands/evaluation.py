# SPDX-License-Identifier: MIT
"""Evaluation of a run: its scores, the reasons to doubt them, and the files that state them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from salsanext_cli.commands.score_limits import JudgedLimit, ScoreLimit, judged_limits, score_values
from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.counts import ScanCounts
from salsanext_cli.core.measures.risk_control import CONSECUTIVE, RiskBoundCheck
from salsanext_cli.core.measures.scores import Scores, band_scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.plain_data import plain
from salsanext_cli.core.texts import escaped
from salsanext_cli.io.files.json_files import encode_json
from salsanext_cli.report.plots import confusion_picture, iou_picture, uncertainty_pictures
from salsanext_cli.runs.loop.run import Failure
from salsanext_cli.runs.scans.selection import MissingResults
from salsanext_cli.runs.summary.comparison import ScanComparison
from salsanext_cli.runs.summary.threshold_scans import NOT_COMPARED, TUNE_AGAIN_HINT
from salsanext_cli.version import __version__

NOT_COVERED = (
    "the guarantee does not cover these scans: `predict` found that they differ from those that "
    f"the threshold was chosen on ({WarningCode.OTHER_SCANS})\nhint: {TUNE_AGAIN_HINT}"
)
ON_TRAINING_SCANS = "scores on scans that the weights were trained on"
UNKNOWN_TRAINING_SCANS = "scores on scans that the weights may have been trained on"


@dataclass(frozen=True, slots=True, kw_only=True)
class Evaluation:
    """Result of comparing predictions with labels."""

    space: LabelSpace  # Classes of the comparison
    comparison: ScanComparison
    counts: ScanCounts  # Of the scored scans: training scans only if there are no others
    scores: Scores  # Scores over all points
    by_distance: dict[str, Scores]  # Scores by name of the band; empty if not requested
    missing: MissingResults  # Skipped scans without predictions
    failures: tuple[Failure, ...]  # Skipped scans that could not be compared
    settings: dict[str, object]  # Settings of the evaluation and of the predictions
    uncertainty: UncertaintyEvaluation  # Results for probabilities and uncertainties, if any
    accepted: AcceptedLabels | None  # Coverage and risk of a run that rejected labels
    guarantee: RiskBoundCheck | None  # Check of the guarantee of `tune risk`, if the run used it
    folder: Path  # Folder of the files
    by_sequence: dict[str, Scores]  # Scores of each sequence by its name

    def files(self) -> dict[str, bytes]:
        """Return the content of the files of an evaluation by name."""
        heading = f"# {self.doubt}\n" if self.doubt else ""
        return {
            "scores.txt": (heading + self.scores.official_yaml()).encode(),
            "eval_iou.png": iou_picture(self.scores, self.space),
            "eval_confusion.png": confusion_picture(self.counts.confusion, self.space),
            **uncertainty_pictures(self.uncertainty),
            "eval.json": encode_json(escaped(self.to_dict())),
        }

    @property
    def doubt(self) -> str:
        """Whether the weights were or may have been trained on the scans, in words; else empty."""
        if self.comparison.trained_on.missing:
            return UNKNOWN_TRAINING_SCANS
        return ON_TRAINING_SCANS if self.counts.training_scans else ""

    @property
    def guarantee_doubt(self) -> str:
        """Why the scans do not test the guarantee of the run, in words; else empty."""
        if self.counts.threshold_scans:
            return "the threshold was chosen on some of these scans"
        if self.comparison.chosen_on.missing:
            return "the record of the scans that the threshold was chosen on is missing"
        if self.guarantee and self.guarantee.are_others:
            return f"the guarantee does not cover these scans ({WarningCode.OTHER_SCANS})"
        if self.guarantee and self.guarantee.consecutive:
            return f"{CONSECUTIVE} ({WarningCode.CONSECUTIVE})"
        if self.guarantee and self.guarantee.incomparable:
            reason = self.guarantee.incomparable
            return f"{NOT_COMPARED} ({reason})"
        return ""

    def judged_limits(self, limits: Sequence[ScoreLimit]) -> list[JudgedLimit]:
        """Compare the scores with limits."""
        values = score_values(self.scores, self.uncertainty, self.accepted)
        return judged_limits(limits, values, self.guarantee, self.guarantee_doubt)

    def warnings(self) -> Iterator[str]:
        """Yield reasons to doubt the scores or the guarantee, in words."""
        yield from self.counts.label_warnings(self.space)
        yield from self.comparison.warnings()
        if self.guarantee and self.guarantee.exceeds_limit:
            yield self.guarantee.warning
        elif self.guarantee and self.guarantee.are_others:
            yield NOT_COVERED

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON; null stands for NaN."""
        counts = self.counts
        is_known = self.comparison.trained_on.missing is None
        unknown_ids = {"truth": counts.unknown_truth, "predictions": counts.unknown_predictions}
        content = {
            "stage": "eval",
            "version": __version__,
            "settings": self.settings,
            "label_space": self.space.name,
            "scans": counts.scans,
            "trained_on": counts.skipped_training_scans if is_known else None,
            "on_training_scans": counts.training_scans > 0 if is_known else None,
            **self.missing.to_dict(),
            "failures": self.failures,
            "unknown_ids": {name: dict(sorted(ids.items())) for name, ids in unknown_ids.items()},
            "scores": self.scores,
            "by_distance": {
                band.name: plain(band.scores)
                | {"iou_mean_same": band.iou_mean_same, "absent": band.absent}
                for band in band_scores(self.by_distance)
            },
            "by_sequence": self.by_sequence,
            "by_scan": dict(sorted(counts.by_scan.items())),
            "classes": self.space.names,
            "confusion": counts.confusion,
            **self.uncertainty.to_json(),
            "rejection": self.accepted and plain(self.accepted) | {"guarantee": self.guarantee},
        }
        return dict(plain(content))
