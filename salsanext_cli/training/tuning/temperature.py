# SPDX-License-Identifier: MIT
"""Temperature scaling (arXiv 1706.04599): one number that calibrates a softmax."""

import logging
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor

from salsanext_cli.core.errors import TrainingError, WeightsError
from salsanext_cli.core.measures.calibration import reliability
from salsanext_cli.core.measures.histograms import confidence_histogram
from salsanext_cli.core.network.card import WeightsCard
from salsanext_cli.core.network.error_model import TEMPERATURES
from salsanext_cli.core.notices import NOTICE
from salsanext_cli.core.records import Float
from salsanext_cli.core.uncertainty.monte_carlo import scan_seed
from salsanext_cli.runs.loop.job import Steps
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.cross_validation import held_out
from salsanext_cli.training.tuning.scans import LabelledImage, Tuned, TuningScans

MAX_LOGITS = 4_000_000  # 32 MB in float64: 200 000 points with 20 classes
SEED = 0  # Seed of the choice of points

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureScores:
    """Calibration of a softmax at a temperature."""

    temperature: float
    nll: float  # Mean negative log-likelihood, nats
    ece: float  # Expected calibration error over 15 bins, 0…1


@dataclass(frozen=True, slots=True, kw_only=True)
class TemperatureFit:
    """Report of the fit of the temperature."""

    before: TemperatureScores
    # With several scans, of each fold of scans at the best temperature of the other ones
    after: TemperatureScores
    folds: int  # Number of folds; 0 for a single scan
    changed: bool  # Whether the weights get the new temperature
    scans: int  # Number of scans
    points: int  # Number of points


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PointLogits:
    """Logits of M points, and their truth."""

    logits: Tensor  # (M, C) float32
    truth: Tensor  # (M,) int64, train ids

    @classmethod
    def joined(cls, scans: Iterable["PointLogits"]) -> "PointLogits":
        """Return the points of some scans in one."""
        members = list(scans)
        logits = torch.cat([points.logits for points in members])
        truth = torch.cat([points.truth for points in members])
        return cls(logits=logits, truth=truth)

    def best_temperature(self) -> float:
        """Return the temperature with the least negative log-likelihood of the points."""
        return best_temperature(self.logits, self.truth)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class TemperedPoints:
    """Points, and the temperature that divides their logits."""

    points: PointLogits
    temperature: float


def fit_temperature(scans: TuningScans) -> Tuned[TemperatureFit]:
    """Fit the temperature with the least negative log-likelihood, unless the existing is better.

    `MAX_LOGITS` limits the points of each scan to a seeded random sample.

    Parameters
    ----------
    scans : TuningScans
        Labelled scans that the weights were not trained on.

    Returns
    -------
    Tuned
        Weights card with the temperature, and the report.

    Raises
    ------
    TrainingError
        If the best temperature is out of range, as for points that are all right.
    """
    card = scans.network.card
    most = max(1, MAX_LOGITS // card.space.class_count // len(scans.files))

    def logits_of(images: Sequence[LabelledImage]) -> list[Float]:
        return scans.network.backend.logits([image.input for image in images])

    job = Steps(prepare=scans.read, compute=logits_of, finish=partial(_sample, most=most))
    points_by_scan = scans.run(job)
    points = PointLogits.joined(points_by_scan.values())
    scans.require_points(len(points.truth))
    temperature = points.best_temperature()
    lowest, highest = TEMPERATURES
    if not lowest <= temperature <= highest:
        # It is 0 where every point is right, infinite where no class of the truth is known.
        problem = f"the best temperature for {len(points.truth)} points is {temperature:g}"
        expected = f"between {lowest:g} and {highest:g}"
        raise TrainingError(scans.source, problem, expected, "use more scans, or other weights")
    folds = _tempered_folds(points_by_scan)
    if not folds:
        log.warning("1 scan: not cross-validated")
    before = _scores(
        [TemperedPoints(points=points, temperature=card.temperature)], card.temperature
    )
    after = _scores(folds or [TemperedPoints(points=points, temperature=temperature)], temperature)
    # Scores of the scan of the fit do not show a gain.
    changed = after.nll < before.nll if folds else card.temperature == 1
    report = TemperatureFit(
        before=before,
        after=after,
        folds=len(folds),
        changed=changed,
        scans=len(scans.files),
        points=len(points.truth),
    )
    if not changed:
        return Tuned(card=card, fit=report)
    if card.risk and card.risk.kind != "error":
        log.log(NOTICE, "the threshold is removed: choose a new one with `salsanext tune risk`")
        card = replace(card, risk=None)
    return Tuned(card=with_temperature(card, temperature, points.logits), fit=report)


def _tempered_folds(points_by_scan: Mapping[ScanFile, PointLogits]) -> list[TemperedPoints]:
    """Return each fold of the scans that have points at the best temperature of the others."""
    lowest, highest = TEMPERATURES
    files = [file for file, points in points_by_scan.items() if len(points.truth)]
    folds = []
    for others, fold in held_out(files):
        best = PointLogits.joined(points_by_scan[file] for file in others).best_temperature()
        points = PointLogits.joined(points_by_scan[file] for file in fold)
        folds.append(TemperedPoints(points=points, temperature=min(max(best, lowest), highest)))
    return folds


def with_temperature(card: WeightsCard, temperature: float, logits: Tensor) -> WeightsCard:
    """Return a card with another temperature, and the same estimated accuracy of logits (N, C)."""
    error = card.error
    accuracy = card.accuracy
    if error:
        # Its features are those at the old temperature.
        error = replace(error, temperature=error.temperature or card.temperature)
    if accuracy and len(logits):
        # The labels do not change, so neither does their estimated accuracy.
        old = _logit_of_confidence(logits, card.temperature)
        new = _logit_of_confidence(logits, temperature)
        accuracy = replace(accuracy, offset=accuracy.offset + accuracy.slope * (old - new))
    return replace(card, temperature=temperature, error=error, accuracy=accuracy)


def _logit_of_confidence(logits: Tensor, temperature: float) -> float:
    """Return the logit of the mean confidence of logits (N, C) at a temperature."""
    softmax = (logits.double() / temperature).softmax(dim=1)
    return softmax.amax(dim=1).mean().logit(1e-6).item()


def _sample(scan: LabelledImage, logits: Float, most: int) -> PointLogits:
    """Return at most `most` points of a scan, with their logits of pixels (C, H, W)."""
    file = scan.file
    count = len(scan.truth)
    if not np.isfinite(logits).all():
        raise WeightsError(file.path, "logits of the network are not finite")
    random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
    chosen = random.choice(count, most, replace=False) if count > most else slice(None)
    log.info("%s: %d points", file.name, min(count, most))
    return PointLogits(
        logits=torch.from_numpy(scan.point_values(logits)[chosen].copy()),
        truth=torch.from_numpy(scan.truth[chosen]).long(),
    )


def _scores(folds: Sequence[TemperedPoints], temperature: float) -> TemperatureScores:
    """Return the scores of all points, each fold at its own temperature.

    `temperature` is the one that the scores are of, in reports.
    """
    softmax = torch.cat(
        [torch.softmax(fold.points.logits / fold.temperature, dim=1) for fold in folds]
    )
    truth = torch.cat([fold.points.truth for fold in folds])
    histogram = confidence_histogram(softmax.numpy(), truth.numpy())
    losses = [
        negative_log_likelihood(fold.points.logits, fold.points.truth, fold.temperature)
        for fold in folds
    ]
    counts = [len(fold.points.truth) for fold in folds]
    return TemperatureScores(
        temperature=temperature,
        nll=float(np.average(losses, weights=counts)),
        ece=reliability(histogram.counts).error,
    )


def negative_log_likelihood(logits: Tensor, truth: Tensor, temperature: float) -> float:
    """Return the mean of −log softmax(logits (N, C) / temperature) at the truth (N,), in nats."""
    return F.cross_entropy(logits.double() / temperature, truth).item()


def best_temperature(logits: Tensor, truth: Tensor) -> float:
    """Return the temperature with the least negative log-likelihood of truth (N,), logits (N, C).

    LBFGS on its logarithm, in float64. The loss is convex in 1/temperature, so there is one
    minimum: 0 if every point is right, infinite if the logits of the true classes are not above
    average.
    """
    exact = logits.double()
    logits_of_truth = exact.gather(1, truth[:, None])[:, 0]
    if (logits_of_truth == exact.amax(dim=1)).all():
        return 0.0
    if logits_of_truth.mean() <= exact.mean(dim=1).mean():
        return math.inf
    logarithm = torch.zeros((), dtype=torch.float64, requires_grad=True)
    limits = {"max_iter": 100, "tolerance_grad": 1e-8, "tolerance_change": 1e-12}
    search = torch.optim.LBFGS([logarithm], **limits, line_search_fn="strong_wolfe")  # type: ignore[arg-type]

    def loss() -> Tensor:
        search.zero_grad()
        mean = F.cross_entropy(exact / logarithm.exp(), truth)
        torch.autograd.backward(mean)
        return mean

    search.step(loss)  # type: ignore[no-untyped-call]
    return math.exp(logarithm.item())
