# SPDX-License-Identifier: MIT
"""The paper's grid search of the dropout rate for sampling."""

import logging
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.core.engines.network import Network
from salsanext_cli.core.errors import TrainingError
from salsanext_cli.core.network.dropout import dropouts
from salsanext_cli.core.records import Double, Float
from salsanext_cli.core.uncertainty.aleatoric import aleatoric
from salsanext_cli.core.uncertainty.monte_carlo import require_sampling, sample, scan_seed
from salsanext_cli.io.weights.loading import with_dropout
from salsanext_cli.runs.loop.job import Steps
from salsanext_cli.runs.scans.scan_file import ScanFile
from salsanext_cli.training.cross_validation import held_out
from salsanext_cli.training.tuning.scans import LabelledImage, Tuned, TuningScans

MIN_VARIANCE = 1e-4
"""(1 % of probability)²: a few certain and wrong points must not outweigh all others."""
SAMPLES = 30  # Passes per scan and rate
RATES: list[float] = np.geomspace(0.02, 0.5, 10).tolist()

log = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True, kw_only=True)
class DropoutFit:
    """Report of the search for the dropout rate."""

    before: float  # Rate of the weights, 0 without dropout
    best: float  # Rate of the new weights
    changed: bool
    rates: Sequence[float]  # Rates that were compared
    objectives: Sequence[float]  # Mean `objective` of a point at each rate
    scans: int
    points: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ScanObjectives:
    """Sums of the objectives of a scan's points."""

    sums: Sequence[float]  # One for each rate
    points: int


def objective(probabilities: Float, variance: Float, truth: npt.NDArray[Any]) -> float:
    """Return Σ ½ log s + (y − p)² / 2s over points and classes; lower is better.

    The negative log-likelihood, except for a constant, of the one-hot truth y (M,) under Gaussians
    with the mean softmax p (M, C) and the total variance s (M, C).
    """
    s = np.maximum(variance.astype(np.float64), MIN_VARIANCE)
    error = probabilities.astype(np.float64)
    error[np.arange(len(truth)), truth] -= 1
    return math.fsum((np.log(s) / 2 + error**2 / (2 * s)).sum(axis=0))


def fit_dropout(scans: TuningScans, samples: int = SAMPLES) -> Tuned[DropoutFit]:
    """Find the rate of `RATES` with the least mean `objective`.

    The existing rate stays unless the rate that other scans choose is better on held-out scans.

    Parameters
    ----------
    scans : TuningScans
        Labelled scans that the weights were not trained on.
    samples : int
        Passes per scan and rate.

    Returns
    -------
    Tuned
        Weights card with the rate, and the report.

    Raises
    ------
    TrainingError
        If the uncertainties of the network are not finite.
    """
    before = max((layer.rate for layer in dropouts(scans.loaded.module)), default=0.0)
    rates = sorted({*RATES, before} - {0.0})
    require_sampling(with_dropout(scans.loaded, RATES[0]), samples)
    scans.loaded.sensor.require_noise()
    network = scans.network
    candidates = [with_dropout(network, rate) for rate in rates]

    job = Steps(
        prepare=scans.read,
        compute=lambda images: [_objectives_of(image, candidates, samples) for image in images],
        finish=lambda _, objectives: objectives,
    )
    scored_scans = list(scans.run(job).values())
    sums = np.array([scan.sums for scan in scored_scans])
    points = sum(scan.points for scan in scored_scans)
    scans.require_points(points)
    objectives: list[float] = (sums.sum(axis=0) / points).tolist()
    if not np.isfinite(objectives).all():
        problem = "uncertainties of the network are not finite"
        raise TrainingError(scans.source, problem, hint="use other weights")
    best = int(np.argmin(objectives))
    changed = not before or _gains(scans.files, sums, rates.index(before))
    if changed and rates[best] in (RATES[0], RATES[-1]):
        text = "the best rate, %g, is at an end of the range: a better one may lie beyond it"
        log.warning(text, rates[best])
    report = DropoutFit(
        before=before,
        best=rates[best] if changed else before,
        changed=changed,
        rates=rates,
        objectives=objectives,
        scans=len(scans.files),
        points=points,
    )
    return Tuned(card=candidates[best].card if changed else network.card, fit=report)


def _objectives_of(
    scan: LabelledImage, candidates: Sequence[Network], samples: int
) -> ScanObjectives:
    """Return the objectives of a scan by networks that differ in their rate."""
    noise = scan.point_values(aleatoric(scan.network, scan.image))
    masks = scan_seed(0, scan.file.sequence, scan.file.stem)
    values = list[float]()
    for candidate in candidates:
        fitted = candidate.for_sensor(scan.network.sensor)
        sampled = sample(fitted, scan.image, samples=samples, seed=masks)
        variance = scan.point_values(sampled.variance) + noise
        probabilities = scan.point_values(sampled.probabilities)
        values.append(objective(probabilities, variance, scan.truth))
    log.info("%s: %d points", scan.file.name, len(scan.truth))
    return ScanObjectives(sums=values, points=len(scan.truth))


def _gains(files: Sequence[ScanFile], sums: Double, before: int) -> bool:
    """Return whether the rates that other scans choose are better on held-out scans.

    `sums` (scans, rates): objectives summed over the points of a scan; `before`: index of the
    existing rate.
    """
    sums_by_scan = dict(zip(files, sums, strict=True))
    folds = held_out(files)
    if not folds:
        return False
    chosen = 0.0
    for others, fold in folds:
        best = np.sum([sums_by_scan[file] for file in others], axis=0).argmin()
        chosen += float(np.sum([sums_by_scan[file] for file in fold], axis=0)[best])
    return chosen < float(sums[:, before].sum())
