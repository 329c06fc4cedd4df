# SPDX-License-Identifier: MIT
"""Limits on scores, and whether scores keep to them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum, auto
from types import MappingProxyType

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.counts import SOFTMAX
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.core.measures.scores import Scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.texts import did_you_mean, with_hint
from salsanext_cli.core.wording import argument, setting
from salsanext_cli.runs.results.folder_names import ERROR

GUARANTEE = "guarantee"
"""Name of the limit that `tune risk` guarantees, which takes no number."""


class NeededResults(Enum):
    """Results of a run that a score needs beside the labels."""

    SOFTMAX = auto()
    ERROR = auto()
    UNCERTAINTY = auto()
    REJECTION = auto()
    REJECTION_BY_RISK = auto()

    @property
    def remedy(self) -> str:
        """Hint that makes the results."""
        predict = "run `salsanext predict` with"
        match self:
            case NeededResults.SOFTMAX:
                return f"{predict} {setting('extras', (SOFTMAX,))}"
            case NeededResults.ERROR:
                return f"{predict} {setting('extras', (ERROR,))}"
            case NeededResults.UNCERTAINTY:
                error = setting("extras", (ERROR,))
                return f"run `salsanext uncertainty`, or `salsanext predict` with {error}"
            case NeededResults.REJECTION:
                return f"{predict} {argument('reject')}"
            case NeededResults.REJECTION_BY_RISK:
                by_risk = setting("reject", "risk")
                return f"{predict} {by_risk} and weights of `salsanext tune risk`"


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreKind:
    """Score that a limit can be set on."""

    higher_is_better: bool  # Whether a limit is the least allowed value, not the largest
    member: str = ""  # What a second name after a dot selects: "class", "uncertainty" or nothing
    unit: str = "%"  # Unit of the score and its limit; empty for a plain number
    needs: NeededResults | None = None  # Results that the score needs beside labels

    @property
    def remedy(self) -> str:
        """Hint that makes the results that the score needs; empty for labels alone."""
        return self.needs.remedy if self.needs else ""


def _higher(member: str = "", needs: NeededResults | None = None) -> ScoreKind:
    """Return a kind of score in % of which a higher one is better."""
    return ScoreKind(higher_is_better=True, member=member, needs=needs)


def _lower(member: str = "", unit: str = "%", needs: NeededResults | None = None) -> ScoreKind:
    """Return a kind of score of which a lower one is better."""
    return ScoreKind(higher_is_better=False, member=member, unit=unit, needs=needs)


SCORE_KINDS: Mapping[str, ScoreKind] = MappingProxyType(
    {
        "accuracy": _higher(),
        "accuracy_official": _higher(),
        "mean_iou": _higher(),
        "mean_iou_frequent": _higher(),
        "mean_iou_official": _higher(),
        "iou": _higher(member="class"),
        "precision": _higher(member="class"),
        "recall": _higher(member="class"),
        "auroc": _higher(member="uncertainty", needs=NeededResults.UNCERTAINTY),
        "aupr": _higher(member="uncertainty", needs=NeededResults.UNCERTAINTY),
        "coverage": _higher(needs=NeededResults.REJECTION),
        "ece": _lower(needs=NeededResults.SOFTMAX),
        "ece_per_scan": _lower(needs=NeededResults.SOFTMAX),
        "ece_of_error": _lower(needs=NeededResults.ERROR),
        "nll": _lower(unit="nats", needs=NeededResults.SOFTMAX),
        "brier": _lower(unit="", needs=NeededResults.SOFTMAX),
        "aurc": _lower(member="uncertainty", needs=NeededResults.UNCERTAINTY),
        "risk": _lower(needs=NeededResults.REJECTION),
        "missed_people": _lower(needs=NeededResults.REJECTION),
        GUARANTEE: _lower(needs=NeededResults.REJECTION_BY_RISK),
    }
)
"""Kinds of scores by the first part of their names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreLimit:
    """Limit on a score."""

    name: str  # Such as "accuracy" and "iou.person"
    limit: float  # In the unit of the score; NaN for the limit of the guarantee

    @property
    def kind(self) -> ScoreKind:
        """Kind of the score."""
        return SCORE_KINDS[self.name.partition(".")[0]]

    def holds(self, score: float) -> bool:
        """Return whether a score keeps to the limit; NaN does not."""
        if self.kind.higher_is_better:
            return score >= self.limit
        return score <= self.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class JudgedLimit:
    """Limit with the score that was compared with it."""

    limit: ScoreLimit
    score: float  # In the unit of the limit; NaN without a value
    is_kept: bool  # False without a value
    reason: str = ""  # Why there is no value, and a hint

    @property
    def name(self) -> str:
        """Name of the score."""
        return self.limit.name

    @property
    def text(self) -> str:
        """Sentence for a message."""
        if self.reason:
            return f"{self.name}: not known, since {self.reason}"
        kind = self.limit.kind
        side = "below" if kind.higher_is_better else "above"
        if self.is_kept:
            side = f"not {side}"
        unit = f" {kind.unit}".rstrip()
        limit = f"{self.limit.limit:g}{unit}"
        return f"{self.name}: {self.score:.4g}{unit}, {side} the limit of {limit}"


def require_classes(limits: Iterable[ScoreLimit], space: LabelSpace) -> None:
    """Refuse limits on classes that a label space does not have, or does not score."""
    names = [name for name, scored in zip(space.names, space.scored, strict=True) if scored]
    for limit in limits:
        member = limit.name.partition(".")[2]
        if limit.kind.member == "class" and member not in names:
            hint = did_you_mean(member, names)
            problem = f"{space.name} scores no class {member!r}"
            raise UsageError(f"limit of {limit.name}", problem, ", ".join(names), hint)


def score_values(
    scores: Scores, uncertainty: UncertaintyEvaluation, accepted: AcceptedLabels | None
) -> dict[str, float]:
    """Return the scores that limits can be set on by name, in the units of their kinds.

    A score is NaN where there is nothing to divide by; one whose results are absent is missing.
    """
    shares = {
        "accuracy": scores.accuracy,
        "accuracy_official": scores.accuracy_official,
        "mean_iou": scores.iou_mean_present,
        "mean_iou_frequent": scores.iou_mean_frequent,
        "mean_iou_official": scores.iou_mean_official,
    }
    for class_scores in scores.classes:
        name = class_scores.name
        # Without points of the class, an IoU of 0 would be no measurement.
        shares[f"iou.{name}"] = class_scores.iou if class_scores.points else math.nan
        shares[f"precision.{name}"] = class_scores.precision
        shares[f"recall.{name}"] = class_scores.recall
    for kind, ranking in uncertainty.kinds.items():
        shares[f"auroc.{kind}"] = ranking.auroc
        shares[f"aupr.{kind}"] = ranking.aupr
        shares[f"aurc.{kind}"] = ranking.aurc
        if ranking.ece is not None:
            shares["ece_of_error"] = ranking.ece
    numbers = {}
    calibration = uncertainty.calibration
    if calibration:
        shares["ece"] = calibration.ece
        shares["ece_per_scan"] = calibration.ece_per_scan
        numbers = {"nll": calibration.nll, "brier": calibration.brier}
    if accepted:
        shares["coverage"] = accepted.coverage
        shares["risk"] = accepted.risk if accepted.accepted else math.nan
        shares["missed_people"] = _ratio(accepted.missed_people, accepted.people)
    return {name: 100 * float(share) for name, share in shares.items()} | numbers


def _ratio(part: int, whole: int) -> float:
    return part / whole if whole else math.nan


def judged_limits(
    limits: Sequence[ScoreLimit],
    values: Mapping[str, float],
    guarantee: RiskBoundCheck | None,
    doubt: str = "",
) -> list[JudgedLimit]:
    """Compare scores with their limits.

    Parameters
    ----------
    limits : sequence of ScoreLimit
        Limits on scores of `values`, and on the guarantee.
    values : mapping of str to float
        As of `score_values`.
    guarantee : RiskBoundCheck or None
        Check of the guarantee of the run, if it has one.
    doubt : str
        Why the check is no evidence about the guarantee; empty if it is.

    Returns
    -------
    list of JudgedLimit
        In the order of the limits.
    """
    judged = []
    for limit in limits:
        if limit.name == GUARANTEE:
            judged.append(_judged_guarantee(limit, guarantee, doubt))
        else:
            judged.append(_judged_score(limit, values))
    return judged


def _judged_score(limit: ScoreLimit, values: Mapping[str, float]) -> JudgedLimit:
    """Return whether a score keeps to its limit; it does not without a value."""
    if limit.name not in values:
        reason = with_hint("the results do not have it", limit.kind.remedy)
        return _unknown(limit, reason)
    score = values[limit.name]
    if math.isnan(score):
        return _unknown(limit, "there is no labelled point to count")
    return JudgedLimit(limit=limit, score=score, is_kept=limit.holds(score))


def _judged_guarantee(
    limit: ScoreLimit, guarantee: RiskBoundCheck | None, doubt: str
) -> JudgedLimit:
    """Return whether the labels keep to the guarantee, and are evidence about it."""
    if guarantee is None:
        reason = with_hint("the run has no guarantee", limit.kind.remedy)
        return _unknown(limit, reason)
    bound = replace(limit, limit=100 * guarantee.limit)
    if doubt and not guarantee.exceeds_limit:
        return _unknown(bound, doubt)
    is_kept = not guarantee.exceeds_limit
    return JudgedLimit(limit=bound, score=100 * guarantee.measured, is_kept=is_kept)


def _unknown(limit: ScoreLimit, reason: str) -> JudgedLimit:
    """Return a limit that is not kept, because its score is not known."""
    return JudgedLimit(limit=limit, score=math.nan, is_kept=False, reason=reason)
