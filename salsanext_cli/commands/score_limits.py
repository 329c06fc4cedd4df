# SPDX-License-Identifier: MIT
"""Limits on scores, as `eval --fail-under` and `eval --fail-over` take them."""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from types import MappingProxyType

from salsanext_cli.core.classes.label_space import LabelSpace
from salsanext_cli.core.errors import UsageError
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.counts import EVALUATED_KINDS
from salsanext_cli.core.measures.risk_control import RiskBoundCheck
from salsanext_cli.core.measures.scores import Scores
from salsanext_cli.core.measures.uncertainty_evaluation import UncertaintyEvaluation
from salsanext_cli.core.texts import did_you_mean, with_hint

FAIL_UNDER = "--fail-under"
FAIL_OVER = "--fail-over"
EXAMPLES = {
    FAIL_UNDER: "limits such as mean_iou=40,iou.person=20",
    FAIL_OVER: "limits such as ece=2,guarantee",
}
GUARANTEE = "guarantee"
"""Name of the limit that `tune risk` guarantees, which takes no number."""
PROBABILITIES = "run `salsanext predict` with --probabilities"
ERROR = "run `salsanext predict` with --error"
UNCERTAINTIES = "run `salsanext uncertainty`, or `salsanext predict` with --error"
REJECT = "run `salsanext predict` with --reject"
REJECT_RISK = "run `salsanext predict` with --reject risk and weights of `salsanext tune risk`"


@dataclass(frozen=True, slots=True)
class ScoreKind:
    """Score that a limit can be set on."""

    option: str  # `FAIL_UNDER` if more is better, else `FAIL_OVER`
    member: str = ""  # What a second name after a dot selects: "class", "uncertainty" or nothing
    unit: str = "%"  # Unit of the score and its limit; empty for a plain number
    made_by: str = ""  # Hint if the results do not have what the score needs


SCORE_KINDS: Mapping[str, ScoreKind] = MappingProxyType(
    {
        "accuracy": ScoreKind(FAIL_UNDER),
        "accuracy_official": ScoreKind(FAIL_UNDER),
        "mean_iou": ScoreKind(FAIL_UNDER),
        "mean_iou_frequent": ScoreKind(FAIL_UNDER),
        "mean_iou_official": ScoreKind(FAIL_UNDER),
        "iou": ScoreKind(FAIL_UNDER, member="class"),
        "precision": ScoreKind(FAIL_UNDER, member="class"),
        "recall": ScoreKind(FAIL_UNDER, member="class"),
        "auroc": ScoreKind(FAIL_UNDER, member="uncertainty", made_by=UNCERTAINTIES),
        "aupr": ScoreKind(FAIL_UNDER, member="uncertainty", made_by=UNCERTAINTIES),
        "coverage": ScoreKind(FAIL_UNDER, made_by=REJECT),
        "ece": ScoreKind(FAIL_OVER, made_by=PROBABILITIES),
        "ece_per_scan": ScoreKind(FAIL_OVER, made_by=PROBABILITIES),
        "ece_of_error": ScoreKind(FAIL_OVER, made_by=ERROR),
        "nll": ScoreKind(FAIL_OVER, unit="nats", made_by=PROBABILITIES),
        "brier": ScoreKind(FAIL_OVER, unit="", made_by=PROBABILITIES),
        "aurc": ScoreKind(FAIL_OVER, member="uncertainty", made_by=UNCERTAINTIES),
        "risk": ScoreKind(FAIL_OVER, made_by=REJECT),
        "missed_people": ScoreKind(FAIL_OVER, made_by=REJECT),
        GUARANTEE: ScoreKind(FAIL_OVER, made_by=REJECT_RISK),
    }
)
"""Kinds of scores by the first part of their names."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ScoreLimit:
    """Limit on a score."""

    option: str  # `FAIL_UNDER` or `FAIL_OVER`
    name: str  # Such as "accuracy" and "iou.person"
    limit: float  # In the unit of the score; NaN for the limit of the guarantee

    @property
    def kind(self) -> ScoreKind:
        """Kind of the score."""
        return SCORE_KINDS[self.name.partition(".")[0]]

    def holds(self, score: float) -> bool:
        """Return whether a score keeps to the limit; NaN does not."""
        return score >= self.limit if self.option == FAIL_UNDER else score <= self.limit


@dataclass(frozen=True, slots=True, kw_only=True)
class MissedLimit:
    """Score that does not keep to its limit, or that has no value."""

    limit: ScoreLimit
    score: float  # In the unit of the limit; NaN without a value
    reason: str = ""  # Why there is no value, and a hint

    @property
    def name(self) -> str:
        """Name of the score."""
        return self.limit.name

    @property
    def option(self) -> str:
        """Option that set the limit."""
        return self.limit.option

    @property
    def text(self) -> str:
        """Sentence for a message."""
        subject = f"{self.option} {self.name}"
        if self.reason:
            return f"{subject}: not known, since {self.reason}"
        side = "below" if self.option == FAIL_UNDER else "above"
        unit = f" {self.limit.kind.unit}".rstrip()
        return f"{subject}: {self.score:.4g}{unit}, {side} the limit of {self.limit.limit:g}{unit}"


def parse_limits(text: str | None, option: str) -> tuple[ScoreLimit, ...]:
    """Return the limits in the value of an option, such as ``mean_iou=40,iou.person=20``."""
    if text is None:
        return ()
    limits: dict[str, ScoreLimit] = {}
    for typed in map(str.strip, text.split(",")):
        name, equals, number = map(str.strip, typed.partition("="))
        _require_kind(name, typed, option)
        if name == GUARANTEE:
            if equals:
                expected = f"{GUARANTEE} without a number: `salsanext tune risk` set its limit"
                raise UsageError(option, f"is {typed}", expected)
            limit = math.nan
        else:
            limit = _number(name, number, option)
        limits[name] = ScoreLimit(option=option, name=name, limit=limit)
    return tuple(limits.values())


def _require_kind(name: str, typed: str, option: str) -> None:
    """Refuse a name that is no score, that lacks its class, or that belongs to the other option."""
    head, _, member = name.partition(".")
    kind = SCORE_KINDS.get(head)
    if kind is None:
        raise _unknown_score(name, option)
    has_member = bool(member)
    needs_member = bool(kind.member)
    if needs_member and not has_member:
        example = "person" if kind.member == "class" else "error"
        article = "a" if kind.member == "class" else "an"
        problem = f"{head} needs {article} {kind.member}"
        raise UsageError(option, problem, f"{head}.{example}, for example")
    if has_member and not needs_member:
        raise UsageError(option, f"no score is called {name!r}", head)
    if kind.member == "uncertainty" and member not in EVALUATED_KINDS:
        hint = did_you_mean(member, EVALUATED_KINDS)
        problem = f"no uncertainty is called {member!r}"
        raise UsageError(option, problem, ", ".join(EVALUATED_KINDS), hint)
    if kind.option != option:
        raise UsageError(option, f"does not apply to {name}", hint=f"use {kind.option} {typed}")


def _unknown_score(name: str, option: str) -> UsageError:
    """Return the error of a name that is no score, with a similar one of the option."""
    head, _, member = name.partition(".")
    kinds = {score: kind for score, kind in SCORE_KINDS.items() if kind.option == option}
    has_member = bool(member)
    similar = [score for score, kind in kinds.items() if bool(kind.member) == has_member]
    hint = did_you_mean(head, similar)
    return UsageError(option, f"no score is called {name!r}", ", ".join(kinds), hint)


def _number(name: str, text: str, option: str) -> float:
    """Return the limit of a score from its text, in its unit."""
    is_share = SCORE_KINDS[name.partition(".")[0]].unit == "%"
    try:
        limit = float(text.removesuffix("%") if is_share else text)
    except ValueError:
        raise UsageError(option, f"{text!r} is not a number", EXAMPLES[option]) from None
    most = 100 if is_share else math.inf
    if not 0 <= limit <= most or math.isinf(limit):
        expected = "0 to 100 %" if is_share else "a finite number of at least 0"
        raise UsageError(option, f"the limit of {name} is {text}", expected)
    if is_share and 0 < limit < 1 and not text.endswith("%"):
        hint = f"use {name}={100 * limit:g}, or {name}={text}% if this is meant"
        raise UsageError(option, f"{name}={text} looks like a share", "limits in %", hint)
    return limit


def require_classes(limits: Iterable[ScoreLimit], space: LabelSpace) -> None:
    """Refuse limits on classes that a label space does not have, or does not score."""
    names = [name for name, scored in zip(space.names, space.scored, strict=True) if scored]
    for limit in limits:
        head, _, member = limit.name.partition(".")
        if limit.kind.member == "class" and member not in names:
            hint = did_you_mean(member, names)
            problem = f"{space.name} scores no class {member!r}"
            raise UsageError(f"{limit.option} {head}", problem, ", ".join(names), hint)


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


def missed_limits(
    limits: Sequence[ScoreLimit],
    values: Mapping[str, float],
    guarantee: RiskBoundCheck | None,
    doubt: str = "",
) -> list[MissedLimit]:
    """Return the limits that scores do not keep to.

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
    list of MissedLimit
    """
    missed = []
    for limit in limits:
        if limit.name == GUARANTEE:
            result = _missed_guarantee(limit, guarantee, doubt)
        else:
            result = _missed_score(limit, values)
        if result:
            missed.append(result)
    return missed


def _missed_score(limit: ScoreLimit, values: Mapping[str, float]) -> MissedLimit | None:
    if limit.name not in values:
        reason = with_hint("the results do not have it", limit.kind.made_by)
        return MissedLimit(limit=limit, score=math.nan, reason=reason)
    score = values[limit.name]
    if math.isnan(score):
        return MissedLimit(limit=limit, score=score, reason="there is no labelled point to count")
    return None if limit.holds(score) else MissedLimit(limit=limit, score=score)


def _missed_guarantee(
    limit: ScoreLimit, guarantee: RiskBoundCheck | None, doubt: str
) -> MissedLimit | None:
    """Return the guarantee if the labels exceed its limit, or are no evidence about it."""
    if guarantee is None:
        reason = with_hint("the run has no guarantee", limit.kind.made_by)
        return MissedLimit(limit=limit, score=math.nan, reason=reason)
    bound = ScoreLimit(option=limit.option, name=GUARANTEE, limit=100 * guarantee.limit)
    exceeds_limit = bool(guarantee.warning)
    if exceeds_limit:
        return MissedLimit(limit=bound, score=100 * guarantee.measured)
    if doubt:
        return MissedLimit(limit=bound, score=math.nan, reason=doubt)
    return None
