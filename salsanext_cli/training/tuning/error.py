# SPDX-License-Identifier: MIT
"""Fit of the probability that a label is wrong, and its scores on points of other scans."""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from functools import partial
from typing import cast

import numpy as np

from salsanext_cli.core.engines.backend import PixelPrediction
from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.geometry.knn import knn_refine
from salsanext_cli.core.measures.calibration import reliability
from salsanext_cli.core.measures.histograms import error_histogram, uncertainty_histogram
from salsanext_cli.core.measures.uncertainty_evaluation import accepted_points, ranking_scores
from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.core.texts import counted, first_few
from salsanext_cli.core.uncertainty.error_features import FEATURES, features_of, knows_error
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed
from salsanext_cli.runs.loop.job import Steps
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.cross_validation import held_out, others_of
from salsanext_cli.training.tuning.error_training import JudgedPoints, fit_error
from salsanext_cli.training.tuning.scans import LabelledImage, Tuned, TuningScans

MAX_POINTS = 1_000_000  # Largest number of points of all scans, 37 MB
MAX_POINTS_OF_SCAN = 20_000  # More points of one scan add little, since they are much alike
FOLDS = 5
SEED = 0  # Seed of the choice of points
ECE_TOLERANCE = 0.005  # Increase of the calibration error that a better ranking may cost
LEAST = 1e-6  # Least probability in a logarithm

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorScores:
    """Scores of probabilities of error on points whose labels are known to be wrong or right."""

    auroc: float  # Area under the ROC curve, 0…1
    aurc: float  # Area under the risk-coverage curve, 0…1
    ece: float  # Expected calibration error, 0…1
    nll: float  # Mean negative log-likelihood, nats
    risk_80: float  # Share of wrong points among the 80 % with the least error, 0…1


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutScores:
    """Scores on the same points of held-out scans; None without folds."""

    folds: int
    error: ErrorScores | None  # Of the models that lack the scan
    existing: ErrorScores | None  # Of the model that the fit starts from, if there is one
    confidence: ErrorScores | None  # Of 1 − the probability of the label


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorFit:
    """Report of the fit of an error model; the card of its weights contains all but `changed`."""

    fitted_to: str  # Number and sequences of the scans, in words
    scans: int
    sequences: list[str]  # Also those of the model that the fit starts from
    points: int
    wrong: float  # Share of the points whose label is wrong, 0…1
    several: float  # Share of skipped points, whose label is of several classes, 0…1
    held_out: HeldOutScores
    changed: bool = False

    def scores(self) -> dict[str, object]:
        """Return the plain data for the card of the weights."""
        return {
            "fitted_to": self.fitted_to,
            "scans": self.scans,
            "sequences": self.sequences,
            "points": self.points,
            "wrong": self.wrong,
            "several": self.several,
            **asdict(self.held_out),
        }

    def to_dict(self) -> dict[str, object]:
        """Return plain data for JSON."""
        return {**self.scores(), "changed": self.changed}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FittedErrorModel:
    """Error model of all scans, with the scores of models that lack a fold of them."""

    model: ErrorModel
    report: ErrorFit


def points_of_scan(scans: int) -> int:
    """Return the largest number of points that are judged in each of some scans."""
    return max(1, min(MAX_POINTS_OF_SCAN, MAX_POINTS // scans))


JudgeJob = Steps[LabelledImage, PixelPrediction, JudgedPoints]


def judge_job(network: Network, read: Callable[[ScanFile], LabelledImage], most: int) -> JudgeJob:
    """Return the job that labels scans as `predict` does, and judges at most `most` points each."""

    def predict(scans: Sequence[LabelledImage]) -> list[PixelPrediction]:
        return network.predict([scan.input for scan in scans], softmax=True)

    return Steps(prepare=read, compute=predict, finish=partial(judged_points, most=most))


def judged_points(scan: LabelledImage, pixels: PixelPrediction, most: int) -> JudgedPoints:
    """Judge a random sample of the points of a scan."""
    network = scan.network
    file = scan.file
    network.backend.require_finite(pixels.confidence, file.path)
    labels = knn_refine(scan.image, pixels.labels, network.space.class_count)
    features = features_of(network, scan.image, cast(Float, pixels.softmax), labels)
    random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
    chosen = random.permutation(len(scan.truth))[:most]
    points = scan.points[chosen]
    wrong = labels[points] != scan.truth[chosen]
    return JudgedPoints(
        features=features[points], wrong=wrong, ambiguous_share=scan.ambiguous_share
    )


def fit_error_model(scans: TuningScans) -> Tuned[ErrorFit]:
    """Fit the probability that a label is wrong, unless the existing model is better.

    The fit starts from the existing model.

    Parameters
    ----------
    scans : TuningScans
        Labelled scans that the weights were not trained on.

    Returns
    -------
    Tuned
        Weights card with the model, and the report.

    Raises
    ------
    TrainingError
        If every label is right, or every label is wrong.
    """
    files = scans.files
    network = scans.network
    judged = scans.run(judge_job(network, scans.read, points_of_scan(len(files))))
    wrong = np.concatenate([points.wrong for points in judged.values()])
    scans.require_points(len(wrong))
    if not has_both_kinds(judged.values()):
        problem = f"{'every' if wrong.all() else 'no'} label of {len(wrong)} points is wrong"
        hint = "use more scans, or other weights"
        raise TrainingError(scans.source, problem, "right and wrong labels", hint)
    start = network.card.error if knows_error(network) else None
    sequences = {file.sequence for file in files}
    fitted_before = set(start.scores.get("sequences", ())) if start else set()
    if same := sequences & fitted_before:
        names = first_few(sorted(same))
        log.warning("the existing error model was fitted to %s: its scores are not held-out", names)
    if len(sequences) == 1 < len(files):
        log.warning("all scans are of one sequence: held-out scans are similar to the others")
    folds = [fold for _, fold in held_out(files, FOLDS)]
    fitted = cross_validated(judged, folds, start=start)
    is_first = not folds and start is None
    report = replace(fitted.report, changed=gains(fitted.report) or is_first)
    if not report.changed:
        return Tuned(card=network.card, fit=report)
    model = replace(fitted.model, temperature=start.temperature if start else None)
    return Tuned(card=replace(network.card, error=model, risk=None), fit=report)


def cross_validated(
    judged: Mapping[ScanFile, JudgedPoints],
    folds: Sequence[Sequence[ScanFile]],
    start: ErrorModel | None = None,
) -> FittedErrorModel:
    """Fit a model to all scans; its scores are of models that lack a fold of the scans.

    Parameters
    ----------
    judged : mapping of ScanFile to JudgedPoints
    folds : sequence of sequence of ScanFile
        Scans that are held out together; without any, there are no scores.
    start : ErrorModel, optional
        As `fit_error` takes it.

    Returns
    -------
    FittedErrorModel
        The scores are in the model too, as the card of weights contains them.
    """
    every = list(judged.values())
    wrong = np.concatenate([points.wrong for points in every])
    sequences = {file.sequence for file in judged}
    fitted_to = f"{counted(len(judged), 'scan')} of {first_few(sorted(sequences))}"
    fitted_before: set[str] = set()
    if start:
        fitted_to += f", from one fitted to {start.scores.get('fitted_to', 'other scans')}"
        fitted_before = set(start.scores.get("sequences", ()))
    report = ErrorFit(
        fitted_to=fitted_to,
        scans=len(judged),
        sequences=sorted(sequences | fitted_before),
        points=len(wrong),
        wrong=float(wrong.mean()),
        several=float(np.mean([points.ambiguous_share for points in every])),
        held_out=_scores_held_out(judged, folds, start),
    )
    model = replace(fit_error(every, start, len(sequences)), scores=report.scores())
    return FittedErrorModel(model=model, report=report)


def _scores_held_out(
    judged: Mapping[ScanFile, JudgedPoints],
    folds: Sequence[Sequence[ScanFile]],
    start: ErrorModel | None,
) -> HeldOutScores:
    """Fit without each fold of the scans, and score all points by the models that lack them."""
    if not folds:
        log.warning("%s: not cross-validated", counted(len(judged), "scan"))
        return HeldOutScores(folds=0, error=None, existing=None, confidence=None)
    errors = list[Float]()
    for fold in folds:
        others = others_of(judged, fold)
        points_of_others = [judged[file] for file in others]
        model = fit_error(points_of_others, start, len({file.sequence for file in others}))
        errors += [model.probability(judged[file].features) for file in fold]
    files = [file for fold in folds for file in fold]
    wrong = np.concatenate([judged[file].wrong for file in files])
    features = np.concatenate([judged[file].features for file in files])
    least_confidence = 1 - features[:, FEATURES.index("probability of the label")]
    return HeldOutScores(
        folds=len(folds),
        error=error_scores(np.concatenate(errors), wrong),
        existing=error_scores(start.probability(features), wrong) if start else None,
        confidence=error_scores(np.clip(least_confidence, 0, 1), wrong),
    )


def has_both_kinds(scans: Iterable[JudgedPoints]) -> bool:
    """Return whether some points are right and some wrong."""
    return len({kind for points in scans for kind in np.unique(points.wrong).tolist()}) > 1


def gains(report: ErrorFit) -> bool:
    """Return whether a model is better on held-out scans than the confidence and its start."""
    held_out_scores = report.held_out
    others = [scores for scores in (held_out_scores.confidence, held_out_scores.existing) if scores]
    if held_out_scores.error is None or not others:
        return False
    return all(is_better(held_out_scores.error, scores) for scores in others)


def is_better(scores: ErrorScores, others: ErrorScores) -> bool:
    """Return whether errors rank better, are more probable and as calibrated on the same points."""
    is_calibrated = scores.ece <= others.ece + ECE_TOLERANCE
    return scores.aurc < others.aurc and scores.nll < others.nll and is_calibrated


def error_scores(error: Float, wrong: Mask) -> ErrorScores:
    """Score probabilities of error (M,) on points that are `wrong` (M,) or right."""
    histogram = uncertainty_histogram(error, wrong)
    ranking = ranking_scores(histogram)
    counts = error_histogram(error, wrong).counts
    likelihood = np.clip(np.where(wrong, error, 1 - error), LEAST, 1)
    return ErrorScores(
        auroc=ranking.auroc,
        aurc=ranking.aurc,
        ece=reliability(counts).error,
        nll=float(-np.log(likelihood).mean()),
        risk_80=accepted_points("error", histogram).risk,
    )
