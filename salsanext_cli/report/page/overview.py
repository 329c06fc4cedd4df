# SPDX-License-Identifier: MIT
"""Overview at the top of a page: tiles with the numbers that decide, and the decision."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from salsanext_cli.core.measures.decision import ADVICE, DOUBTFUL, Evidence, verdict
from salsanext_cli.core.measures.expected_accuracy import ExpectedAccuracy
from salsanext_cli.core.texts import counted, percentage
from salsanext_cli.core.wording import argument
from salsanext_cli.report.page.decision_command import decision_command
from salsanext_cli.report.page.run_results import Comparison, RunResults
from salsanext_cli.report.page.scan_row import Rejection
from salsanext_cli.report.tables import percent
from salsanext_cli.runs.results.provenance import Provenance

WITHHELD = "withheld"


@dataclass(frozen=True, slots=True)
class Tile:
    """A number and its meaning."""

    value: str
    meaning: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Advice:
    """What to do with the labels of a run."""

    title: str
    reason: str
    command: str  # Command that follows; empty if there is none


@dataclass(frozen=True, slots=True, kw_only=True)
class Overview:
    """The numbers that decide, the decision, and sentences on risk."""

    tiles: Sequence[Tile]
    advice: Advice | None  # None if the numbers allow no decision
    sentences: Sequence[str]


def overview(run: RunResults, compared: Comparison | None) -> Overview:
    """Return the tiles and the sentences that lead to a decision.

    Parameters
    ----------
    run : RunResults
        Numbers of all scans.
    compared : Comparison or None
        Their comparison with labels; None without labels.

    Returns
    -------
    Overview
    """
    evidence = run.evidence()
    advice = _advice(run, evidence)
    sentences = _risk_sentences(compared) if compared else []
    if advice is None and run.reader.rejects:
        sentences = [_no_decision(), *sentences]
    return Overview(tiles=list(_tiles(run, compared, evidence)), advice=advice, sentences=sentences)


def _tiles(run: RunResults, compared: Comparison | None, evidence: Evidence) -> Iterator[Tile]:
    points = sum(row.points for row in run.rows)
    scans = "scan" if len(run.rows) == 1 else "scans"
    yield Tile(f"{len(run.rows):,}", f"{scans}, {counted(points, 'point')}")
    if compared:
        yield from _score_tiles(compared)
    yield from _estimate_tiles(run, evidence.expected)
    errors = run.errors
    mean = errors.mean
    doubtful = errors.doubtful_share
    if mean is not None and doubtful is not None:
        above = f"{percent(doubtful, 1, ' %')} of them above {percentage(DOUBTFUL, 0)}"
        included = " (rejected ones included)" if run.reader.rejects else ""
        points_of_errors = f"{counted(errors.points, 'point')} with a label{included}"
        meaning = f"mean probability of error of {points_of_errors}, {above}"
        yield Tile(percent(mean, 1, " %"), meaning)
    rejected = _rejection(run)
    if rejected:
        share = sum((row.rejected for row in run.rows), Rejection()).share
        yield Tile(percent(share, 1, " %"), f"of the points with a label rejected: {rejected}")
    yield _warning_tile(run, evidence)


def _score_tiles(compared: Comparison) -> Iterator[Tile]:
    """Yield accuracy and mean IoU, or coverage and risk of a run that rejected labels."""
    scores = compared.scores
    which = "trained on" if compared.counts.training_scans else "with labels"
    scans = f"{counted(compared.counts.scans, 'scan')} {which}"
    labelled = counted(scores.points, "labelled point")
    labels = compared.accepted
    if labels:
        points = sum(scan.points for scan in compared.counts.accepted.values())
        coverage = f"coverage: accepted of {counted(points, 'labelled point')}, {scans}"
        yield Tile(percent(labels.coverage, 1, " %"), coverage)
        risk = f"risk: wrong of {counted(scores.points, 'accepted point')}"
        yield Tile(percent(labels.risk, 1, " %"), risk)
        return
    yield Tile(percent(scores.accuracy, 1, " %"), f"accuracy: right of {labelled}, {scans}")
    present = sum(c.points > 0 for c in scores.classes)
    yield Tile(percent(scores.iou_mean_present, 1, " %"), f"mean IoU of {present} classes present")
    if present < len(scores.classes):
        every = f"mean IoU of all {len(scores.classes)}, official"
        yield Tile(percent(scores.iou_mean_official, 1, " %"), every)


def _estimate_tiles(run: RunResults, expected: ExpectedAccuracy | None) -> Iterator[Tile]:
    """Yield the interval of the estimated accuracy, or why there is none."""
    if expected is None:
        if _rejection(run):
            yield Tile(WITHHELD, "estimated accuracy: not known after labels were rejected")
        return
    reasons = ", ".join(f"{code} in {counted(n, 'scan')}" for code, n in expected.withheld.items())
    if expected.interval is None:
        yield Tile(WITHHELD, f"estimated accuracy: {reasons}")
        return
    low = math.floor(100 * expected.interval[0])
    high = math.ceil(100 * expected.interval[1])
    scans = f" of {counted(expected.scans, 'scan')}; withheld: {reasons}" if reasons else ""
    yield Tile(f"{low} to {high} %", f"estimated accuracy, from confidence{scans}")


def _rejection(run: RunResults) -> str:
    """Describe the threshold of a run that rejected labels; empty without one."""
    settings = Provenance(run.reader.out).prediction()
    if settings is None or settings.reject is None:
        return ""
    kind = (settings.reject_by or "error").replace("_", " ")
    return f"{kind} above {settings.reject:.3g}"


def _warning_tile(run: RunResults, evidence: Evidence) -> Tile:
    """Return the number of scans with warnings, and with each code."""
    warned = sum(bool(codes) for codes in run.codes.values())
    counts = sorted(evidence.warned.items(), key=lambda item: (-len(item[1]), item[0]))
    codes = ", ".join(f"{code} {len(names):,}" for code, names in counts)
    return Tile(
        f"{warned:,}", f"{'scan' if warned == 1 else 'scans'} with warnings{codes and f': {codes}'}"
    )


def _advice(run: RunResults, evidence: Evidence) -> Advice | None:
    """Return the decision and the command that follows from it; None if unknown."""
    decided = verdict(evidence)
    if decided is None:
        return None
    return Advice(
        title=ADVICE[decided.decision],
        reason=decided.reason,
        command=decision_command(run, decided),
    )


def _no_decision() -> str:
    """Return why there is no decision about a run that rejected labels."""
    why = "No decision about the labels: some were rejected, and a decision judges all."
    remedy = f"The report of a run without {argument('reject')} has one."
    return f"{why} {remedy}"


def _risk_sentences(compared: Comparison) -> list[str]:
    """Return the sentences on risk; empty without uncertainty."""
    sentences = list(compared.sentences)
    best = compared.uncertainty.accepted
    if best:
        sentences.append(best.sentence)
    return [f"{sentence[:1].upper()}{sentence[1:]}." for sentence in sentences]
