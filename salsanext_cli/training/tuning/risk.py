# SPDX-License-Identifier: MIT
"""Threshold above which labels are rejected, chosen so that a new scan has few wrong labels."""

import logging
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.checks.warning_codes import WarningCode
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.measures.accepted_labels import AcceptedLabels
from salsanext_cli.core.measures.histograms import UNCERTAINTY_BINS, highest_of_bins
from salsanext_cli.core.measures.population import traits_of_units
from salsanext_cli.core.measures.risk_control import (
    enough_drives,
    held_thresholds,
    likely_thresholds,
    means_of_units,
    needed_drives,
)
from salsanext_cli.core.measures.scores import Counts, Ratios
from salsanext_cli.core.network.card import RiskThreshold
from salsanext_cli.core.network.unit_traits import UnitTraits
from salsanext_cli.core.sensors.sensor import FittedView
from salsanext_cli.core.texts import first_few, percentage, with_hint
from salsanext_cli.core.uncertainty.error_features import knows_error
from salsanext_cli.core.wording import argument
from salsanext_cli.runs.fit.threshold_settings import label_settings
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.runs.scans.selection import data_set_of
from salsanext_cli.runs.summary.scan_warnings import ScanWarning, log_recorded
from salsanext_cli.training.tuning.consecutive import consecutive_warning
from salsanext_cli.training.tuning.judged_scans import JudgedScan, judged_scans
from salsanext_cli.training.tuning.risk_level import (
    FewUnits,
    RiskLevel,
    TooFewScansError,
    require_scans,
)
from salsanext_cli.training.tuning.risk_report import (
    AcceptedScan,
    ComputedBy,
    FewScansReport,
    HeldOutSequence,
    RiskCurve,
    RiskFit,
)
from salsanext_cli.training.tuning.scans import Tuned, TuningScans

LEAST_COVERAGE = 0.25  # Share of accepted points below which a threshold is of little use

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class ShareTable:
    """Shares of the points of n scans by threshold, with their sequences and units."""

    accepted: Ratios  # (n, B): share of the points that are accepted, 0…1
    wrong: Ratios  # (n, B): share of the points that are accepted and wrong, 0…1
    sequences: npt.NDArray[np.str_]  # (n,)
    units: npt.NDArray[Any]  # (n,): scan or drive that the guarantee counts, as a number or name

    @classmethod
    def from_scans(cls, judged: Sequence[JudgedScan], unit: str) -> "ShareTable":
        """Return the shares of judged scans; `unit` is "scan" or "drive"."""
        sequences = np.array([scan.file.sequence for scan in judged])
        return cls(
            accepted=np.stack([scan.shares_accepted for scan in judged]),
            wrong=np.stack([scan.shares_wrong for scan in judged]),
            sequences=sequences,
            units=sequences if unit == "drive" else np.arange(len(judged)),
        )

    @property
    def losses(self) -> Ratios:
        """Mean share of accepted and wrong points of each unit, (U, B)."""
        return means_of_units(self.wrong, self.units)

    @property
    def unit_count(self) -> int:
        """Number of the units."""
        return len(np.unique(self.units))

    def chosen(self, rows: npt.NDArray[np.bool_]) -> "ShareTable":
        """Return the table of some of its scans; `rows` is a mask (n,)."""
        return ShareTable(
            accepted=self.accepted[rows],
            wrong=self.wrong[rows],
            sequences=self.sequences[rows],
            units=self.units[rows],
        )


def fit_risk(scans: TuningScans, level: RiskLevel) -> Tuned[RiskFit]:
    """Choose the highest threshold of error, else of least confidence, that keeps to a level.

    The unit of the guarantee is the drive if there are enough, else the scan.

    Parameters
    ----------
    scans : TuningScans
        Labelled scans that the weights were not trained on.
    level : RiskLevel
        Limit of the share of accepted and wrong points.

    Returns
    -------
    Tuned
        Weights card with the threshold, and the report.

    Raises
    ------
    TooFewScansError
        If so few scans cannot guarantee the level.
    TrainingError
        If every threshold exceeds the level.
    """
    require_scans(scans.source, len(scans.files), level)
    unit = _unit_of_guarantee(scans.files, level)
    few = _few_units(scans.files, unit, level)
    kind = "error" if knows_error(scans.network) else "least_confidence"
    warnings_of_fit = _warnings_of_fit(scans)
    classes = scans.space.class_count
    counts = np.zeros((classes, classes, UNCERTAINTY_BINS + 1), np.int64)
    judged = judged_scans(scans, kind, counts)
    shares = ShareTable.from_scans(judged, unit)
    bins = held_thresholds(shares.losses, level.at_most, level.confidence)
    if not bins or not shares.accepted[:, bins - 1].any():
        raise _no_threshold(scans.source, kind, few, level)
    points = [_accepted_points(scan, bins) for scan in judged]
    labels = AcceptedLabels.from_confusion(
        _confusion_of_accepted(counts, bins),
        scans.space,
        {scan.scan: scan.counts for scan in points},
    )
    warnings = [*warnings_of_fit, *_warnings(scans.files, unit, level)]
    is_consecutive = any(warning.code == WarningCode.CONSECUTIVE for warning in warnings)
    threshold = _threshold(
        scans, judged, kind, unit, level, bins, consecutive=is_consecutive or None
    )
    others = held_out_sequences(shares, level)
    report = RiskFit(
        threshold=threshold,
        accepted=labels,
        held_out=others,
        scans=points,
        few=_report_of_few(few, judged, shares.losses, labels) if few else None,
        curve=RiskCurve.from_shares(shares.accepted, shares.wrong),
        computed_by=ComputedBy.from_network(scans.network),
        warnings=warnings,
    )
    if few is None and labels.coverage < LEAST_COVERAGE:
        text = f"the threshold accepts only {percentage(labels.coverage)} of the points"
        hint = f"use a higher {argument('at_most')}, or scans of more drives"
        log.warning("%s", with_hint(text, hint))
    _warn_of_held_out(others, level, unit)
    return Tuned(card=replace(scans.network.card, risk=threshold), fit=report)


def held_out_sequences(shares: ShareTable, level: RiskLevel) -> list[HeldOutSequence]:
    """Return each sequence at the threshold of the others; nothing for a single sequence."""
    names = np.unique(shares.sequences)
    if len(names) == 1:
        return []
    reports = []
    for name in names:
        is_held_out = shares.sequences == name
        others = shares.chosen(~is_held_out)
        bins = held_thresholds(
            others.losses, level.at_most, level.confidence, scans=shares.unit_count
        )
        scans = int(is_held_out.sum())
        accepted = shares.accepted[is_held_out, bins - 1] if bins else np.zeros(scans)
        wrong = shares.wrong[is_held_out, bins - 1] if bins else np.zeros(scans)
        reports.append(
            HeldOutSequence(
                sequence=str(name),
                scans=scans,
                accepted=float(accepted.mean()),
                loss=float(wrong.mean()),
                worst=float(wrong.max()),
                above=float((wrong > level.at_most).mean()),
            )
        )
    return reports


def _unit_of_guarantee(files: Sequence[ScanFile], level: RiskLevel) -> str:
    """Return "drive" if there are enough sequences for a level, else "scan"."""
    drives = len({file.sequence for file in files})
    return "drive" if enough_drives(drives, level.at_most, level.confidence) else "scan"


def _threshold(
    scans: TuningScans,
    judged: Sequence[JudgedScan],
    kind: str,
    unit: str,
    level: RiskLevel,
    bins: int,
    *,
    consecutive: bool | None,
) -> RiskThreshold:
    """Return the threshold at the end of a number of bins, with what it depends on."""
    network = scans.network
    return RiskThreshold(
        kind=kind,
        threshold=min(float(highest_of_bins()[bins - 1]), 1.0),
        at_most=level.at_most,
        confidence=level.confidence,
        unit=unit,
        scans=len(judged),
        sequences=tuple(sorted({scan.file.sequence for scan in judged})),
        digests="".join(scan.digest for scan in judged),
        settings=label_settings(scans.settings, network),
        views=tuple(FittedView.from_sensor(member) for member in network.sensor.members),
        population=_population(judged, unit),
        data_set=(data_set_of(scans.files[0]) or scans.source).resolve().name,
        consecutive=consecutive,
    )


def _accepted_points(scan: JudgedScan, bins: int) -> AcceptedScan:
    """Return the points of a scan in a number of bins."""
    return AcceptedScan(
        scan=scan.file.name,
        digest=scan.digest,
        points=scan.points,
        accepted=int(scan.accepted[bins - 1]),
        wrong=int(scan.wrong[bins - 1]),
    )


def _confusion_of_accepted(counts: Counts, bins: int) -> Counts:
    """Return the confusion matrix (C, C) of `counts` (C, C, B + 1), with rejected points as 0."""
    confusion: Counts = counts[..., :bins].sum(axis=2)
    confusion[:, 0] += counts[..., bins:].sum(axis=(1, 2))
    return confusion


def _population(judged: Sequence[JudgedScan], unit: str) -> tuple[UnitTraits, ...]:
    """Return the traits of each scan or drive."""
    traits = [scan.traits for scan in judged if scan.traits]
    if unit == "scan":
        return tuple(traits)
    return traits_of_units(traits, [scan.file.sequence for scan in judged])


def _no_threshold(source: Path, kind: str, few: FewUnits | None, level: RiskLevel) -> TrainingError:
    """Return the error about a level that every threshold exceeds."""
    limit = percentage(level.at_most, figures=3)
    problem = f"no threshold of {kind} accepts a point within {limit}"
    if few:
        return TooFewScansError(source, problem, hint=few.hint)
    hint = f"use a higher {argument('at_most')}, or better weights"
    return TrainingError(source, problem, hint=hint)


def _few_units(files: Sequence[ScanFile], unit: str, level: RiskLevel) -> FewUnits | None:
    """Return the scans or drives if they are few for a level, and warn of it."""
    sequences = {file.sequence for file in files}
    count = len(sequences) if unit == "drive" else len(set(files))
    few = FewUnits.among(count, unit, level)
    if few:
        few.warn_before()
    return few


def _report_of_few(
    few: FewUnits, judged: Sequence[JudgedScan], losses: Ratios, labels: AcceptedLabels
) -> FewScansReport:
    """Estimate what more scans with equal losses would accept, and warn."""
    level = few.level
    bins = likely_thresholds(losses, level.at_most, level.confidence, few.useful)
    accepted = sum(int(scan.accepted[bins - 1]) for scan in judged) if bins else 0
    by_useful = accepted / sum(scan.points for scan in judged)
    few.warn_after(labels.coverage, by_useful)
    return FewScansReport(left=few.left, useful=few.useful, accepted_by_useful=by_useful)


def _warnings(files: Sequence[ScanFile], unit: str, level: RiskLevel) -> list[ScanWarning]:
    """Log and return reasons to doubt the guarantee of scans."""
    if unit == "drive":
        return []
    warning = consecutive_warning(files, needed_drives(level.at_most, level.confidence))
    warnings = [warning] if warning else []
    log_recorded(warnings)
    return warnings


def _warn_of_held_out(others: Sequence[HeldOutSequence], level: RiskLevel, unit: str) -> None:
    """Warn of held-out sequences that exceed the level, or that there are none."""
    if not others:
        log.warning("scans of one sequence do not show whether another one keeps to the level")
        return
    above = [sequence.sequence for sequence in others if sequence.exceeds(level)]
    if above and unit == "scan":
        log.warning("%s: above the level with the threshold of the others", first_few(above))


def _warnings_of_fit(scans: TuningScans) -> list[ScanWarning]:
    """Log and return a warning if the error model was fitted to sequences of the scans."""
    error = scans.network.card.error if knows_error(scans.network) else None
    fitted = set(error.scores.get("sequences", ())) if error else set()
    same = sorted(fitted & {file.sequence for file in scans.files})
    if not same:
        return []
    warning = ScanWarning(
        code=WarningCode.SEEN_BY_FIT,
        message="the error model was fitted to it too, but a guarantee needs scans that no fit saw",
        hint="choose the threshold on scans of other sequences",
        scans=same,
    )
    log_recorded([warning])
    return [warning]
