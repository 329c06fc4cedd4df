# SPDX-License-Identifier: MIT
"""Fit of the probability that a label is wrong, and its scores on points of other scans."""

import logging
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import cast

import numpy as np
import torch
import torch.nn.functional as F
from torch import nn

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
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.training.cross_validation import held_out
from salsanext_cli.training.tuning.scans import LabelledImage, Tuned, TuningScans

MAX_POINTS = 1_000_000  # Largest number of points of all scans, 37 MB
MAX_POINTS_OF_SCAN = 20_000  # More points of one scan add little, since they are much alike
FOLDS = 5
SEED = 0  # Seed of the choice of points, of the initial weights and of the order of the points
HIDDEN = 16  # Values of each of the two hidden layers
EPOCHS, BATCH = 8, 2048  # Passes over the points, and points per step
MIN_STEPS = 400  # Few points are passed over more often
LEARNING_RATE, WEIGHT_DECAY = 3e-3, 1e-4
ECE_TOLERANCE = 0.005  # Increase of the calibration error that a better ranking may cost
SEQUENCES_OF_START = 7  # Weight of an existing model, in sequences
LEAST = 1e-6  # Least probability in a logarithm
HEIGHT = FEATURES.index("height above the sensor")
MIN_SPREAD = 1e-3  # Least divisor of features, which may hardly differ

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPoints:
    """Points of one scan whose labels are known to be wrong or right."""

    features: Float  # (M, F), in the order of `FEATURES`
    wrong: Mask  # (M,)
    several: float = 0.0  # Share of skipped points, whose label is of several classes


def points_of_scan(scans: int) -> int:
    """Return the largest number of points that are judged in each of some scans."""
    return max(1, min(MAX_POINTS_OF_SCAN, MAX_POINTS // scans))


JudgeJob = Steps[LabelledImage, PixelPrediction, JudgedPoints]


def judge_job(network: Network, read: Callable[[ScanFile], LabelledImage], most: int) -> JudgeJob:
    """Return the job that labels scans as `predict` does, and judges at most `most` points each."""

    def predict(scans: Sequence[LabelledImage]) -> list[PixelPrediction]:
        return network.predict([scan.input for scan in scans], softmax=True)

    return Steps(read, predict, partial(judged_points, most=most))


def judged_points(scan: LabelledImage, pixels: PixelPrediction, most: int) -> JudgedPoints:
    """Judge a random sample of the points of a scan."""
    network, file = scan.network, scan.file
    network.backend.require_finite(pixels.confidence, file.path)
    labels = knn_refine(scan.image, pixels.labels, network.space.class_count)
    features = features_of(network, scan.image, cast(Float, pixels.softmax), labels)
    random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
    chosen = random.permutation(len(scan.truth))[:most]
    points = scan.points[chosen]
    wrong = labels[points] != scan.truth[chosen]
    return JudgedPoints(features[points], wrong, scan.several)


def fit_error_model(scans: TuningScans) -> Tuned:
    """Fit the probability that a label is wrong, unless the existing model is better.

    The fit starts from the existing model. The report has the scores of both and of the confidence
    on the same held-out scans, and whether the weights were `changed`.
    """
    files, network = scans.files, scans.network
    judged = scans.run(judge_job(network, scans.read, points_of_scan(len(files))))
    wrong = np.concatenate([points.wrong for points in judged.values()])
    scans.require_points(len(wrong))
    if not of_both_kinds(judged.values()):
        problem = f"{'every' if wrong.all() else 'no'} label of {len(wrong)} points is wrong"
        hint = "use more scans, or other weights"
        raise TrainingError(scans.source, problem, "right and wrong labels", hint)
    start = network.card.error if knows_error(network) else None
    sequences = {file.sequence for file in files}
    if start and (same := sequences & {*start.scores.get("sequences", ())}):
        names = first_few(sorted(same))
        log.warning("the existing error model was fitted to %s: its scores are not held-out", names)
    if len(sequences) == 1 < len(files):
        log.warning("all scans are of one sequence: held-out scans are similar to the others")
    parts = [part for _, part in held_out(files, FOLDS)]
    model = cross_validated(judged, parts, start=start)
    changed = gains(model) or not (model.scores["folds"] or start)
    report = {**model.scores, "changed": changed}
    if not changed:
        return network.card, report
    model = replace(model, temperature=start.temperature if start else None)
    return replace(network.card, error=model, risk=None), report


def cross_validated(
    judged: Mapping[ScanFile, JudgedPoints],
    parts: Sequence[Sequence[ScanFile]],
    start: ErrorModel | None = None,
) -> ErrorModel:
    """Fit a model to all scans; its scores are of models that lack a fold of the scans.

    `start`: as `fit_error` takes it. The scores include the sequences, also of the `start`; the
    share of `wrong` points; the share of skipped points, of `several` classes; and `error_scores`
    of the model, `error`, of the `existing` one and of 1 − the probability of the label,
    `confidence`. These are None without folds.
    """
    every = list(judged.values())
    wrong = np.concatenate([points.wrong for points in every])
    sequences = {file.sequence for file in judged}
    before = start.scores if start else {}
    from_one = f", from one fitted to {before.get('fitted_to', 'other scans')}" if start else ""
    scores = {
        "fitted_to": f"{counted(len(judged), 'scan')} of {first_few(sorted(sequences))}{from_one}",
        "scans": len(judged),
        "sequences": sorted(sequences | {*before.get("sequences", ())}),
        "points": len(wrong),
        "wrong": float(wrong.mean()),
        "several": float(np.mean([points.several for points in every])),
        **_scores_held_out(judged, parts, start),
    }
    return replace(fit_error(every, start, len(sequences)), scores=scores)


def _scores_held_out(
    judged: Mapping[ScanFile, JudgedPoints],
    parts: Sequence[Sequence[ScanFile]],
    start: ErrorModel | None,
) -> dict[str, object]:
    """Fit without each fold of the scans, and score all points by the models that lack them."""
    if not parts:
        log.warning("%s: not cross-validated", counted(len(judged), "scan"))
        return {"folds": 0, "error": None, "existing": None, "confidence": None}
    errors = list[Float]()
    for part in parts:
        rest = {file: points for file, points in judged.items() if file not in part}
        model = fit_error(list(rest.values()), start, len({file.sequence for file in rest}))
        errors += [model.probability(judged[file].features) for file in part]
    files = [file for part in parts for file in part]
    wrong = np.concatenate([judged[file].wrong for file in files])
    features = np.concatenate([judged[file].features for file in files])
    least_confidence = 1 - features[:, FEATURES.index("probability of the label")]
    return {
        "folds": len(parts),
        "error": error_scores(np.concatenate(errors), wrong),
        "existing": error_scores(start.probability(features), wrong) if start else None,
        "confidence": error_scores(np.clip(least_confidence, 0, 1), wrong),
    }


def of_both_kinds(scans: Iterable[JudgedPoints]) -> bool:
    """Return whether some points are right and some wrong."""
    return len({kind for points in scans for kind in np.unique(points.wrong).tolist()}) > 1


def gains(model: ErrorModel) -> bool:
    """Return whether a model is better on held-out scans than the confidence and its start."""
    rows = [row for name in ("confidence", "existing") if (row := model.scores[name])]
    return bool(rows) and all(is_better(model.scores["error"], row) for row in rows)


def is_better(scores: Mapping[str, float], others: Mapping[str, float]) -> bool:
    """Return whether errors rank better, are more probable and as calibrated on the same points."""
    better = all(scores[name] < others[name] for name in ("aurc", "nll"))
    return better and scores["ece"] <= others["ece"] + ECE_TOLERANCE


def fit_error(
    scans: Sequence[JudgedPoints], start: ErrorModel | None = None, sequences: int = 1
) -> ErrorModel:
    """Fit a model with the least cross-entropy to points of a number of sequences.

    A model to `start` from counts as `SEQUENCES_OF_START` sequences: the truth is mixed with its
    probability. The height has no weight, since it depends on the mounting.
    """
    features = np.concatenate([scan.features for scan in scans])
    wrong = torch.from_numpy(np.concatenate([scan.wrong for scan in scans])).float()
    mean, spread = features.mean(axis=0), np.maximum(features.std(axis=0), MIN_SPREAD)
    sizes = [(len(FEATURES), HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, 1)]
    if start:
        share = sequences / (sequences + SEQUENCES_OF_START)
        wrong = share * wrong + (1 - share) * torch.from_numpy(start.probability(features))
        sizes = [weight.shape for weight, _ in start.layers]
    spread[HEIGHT] = np.inf
    values = torch.from_numpy((features - mean) / spread)
    with torch.random.fork_rng([]):
        torch.manual_seed(SEED)  # noqa: TID251
        linear = [nn.Linear(*size) for size in sizes]
        model = nn.Sequential(*(m for layer in linear for m in (layer, nn.ReLU())))[:-1]
        if start:
            (weight, bias), *others = start.layers
            scale = np.where(np.isinf(spread), 0, spread)
            first_layer = (weight * scale[:, None], bias + mean @ weight)
            with torch.no_grad():
                for layer, (weight, bias) in zip(linear, (first_layer, *others), strict=True):
                    layer.weight.copy_(torch.from_numpy(weight.T))
                    layer.bias.copy_(torch.from_numpy(bias))
        steps_per_epoch = -(-len(values) // BATCH)
        epochs = max(EPOCHS, -(-MIN_STEPS // steps_per_epoch))
        optimiser = torch.optim.AdamW(model.parameters(), LEARNING_RATE, weight_decay=WEIGHT_DECAY)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, LEARNING_RATE, epochs=epochs, steps_per_epoch=steps_per_epoch
        )
        for _ in range(epochs):
            order = torch.randperm(len(values))
            for first in range(0, len(values), BATCH):
                batch = order[first : first + BATCH]
                logits = model(values[batch])[:, 0]
                loss = F.binary_cross_entropy_with_logits(logits, wrong[batch])
                optimiser.zero_grad()
                torch.autograd.backward(loss)
                optimiser.step()
                schedule.step()
    layers = [(m.weight.detach().numpy().T.copy(), m.bias.detach().numpy()) for m in linear]
    weight, bias = layers[0]
    weight = weight / spread[:, None]
    layers[0] = weight.astype(np.float32), (bias - mean @ weight).astype(np.float32)
    return ErrorModel(FEATURES, layers)


def error_scores(error: Float, wrong: Mask) -> dict[str, float]:
    """Return `auroc`, `aurc`, `ece`, `nll` in nats of errors (M,), and the `risk_80` of 80 %."""
    histogram = uncertainty_histogram(error, wrong)
    ranking = ranking_scores(histogram)
    counts = error_histogram(error, wrong).counts
    return {
        "auroc": ranking.auroc,
        "aurc": ranking.aurc,
        "ece": reliability(counts).error,
        "nll": float(-np.log(np.clip(np.where(wrong, error, 1 - error), LEAST, 1)).mean()),
        "risk_80": accepted_points("error", histogram).risk,
    }
