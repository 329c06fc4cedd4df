# SPDX-License-Identifier: MIT
"""The paper's grid search of the dropout rate to sample with."""

import logging
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.engines.loading import with_dropout
from salsanext_cli.errors import TrainingError, UsageError
from salsanext_cli.geometry.network_input import noise_of
from salsanext_cli.network.dropout import dropouts
from salsanext_cli.parallel.job import Steps
from salsanext_cli.records import Double, Float
from salsanext_cli.results.paths import ScanFile
from salsanext_cli.training.cross_validation import held_out
from salsanext_cli.training.tuning.scans import LabelledImage, Tuned, TuningScans
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.monte_carlo import require_sampling, sample, scan_seed

MIN_VARIANCE = 1e-4
"""(1 % of probability)²: a few sure and wrong points must not weigh more than all others."""
SAMPLES = 30  # Passes per scan and rate
LOWEST, HIGHEST, STEPS = 0.02, 0.5, 10  # Ends of the range of rates, and their number

log = logging.getLogger(__name__)


def rates_between(lowest: float, highest: float, steps: int) -> list[float]:
    """Return rates at equal steps of their logarithm, both ends included."""
    if not 0 < lowest < highest < 1:
        found = f"{lowest:g} and {highest:g}"
        raise UsageError("--lowest and --highest", found, "rising rates above 0 and below 1")
    if steps < 2:
        raise UsageError("--steps", str(steps), "at least 2")
    inner = np.geomspace(lowest, highest, steps)[1:-1].tolist()
    return [lowest, *inner, highest]


def objective(probabilities: Float, variance: Float, truth: npt.NDArray[Any]) -> float:
    """Return Σ ½ log s + (y − p)² / 2s over points and classes; lower is better."""
    # It is the negative log-likelihood, but for a constant, of the one-hot truth y (M,) under
    # Gaussians of mean p (M, C), the mean softmax of the passes, and total variance s (M, C).
    s = np.maximum(variance.astype(np.float64), MIN_VARIANCE)
    error = probabilities.astype(np.float64)
    error[np.arange(len(truth)), truth] -= 1
    return math.fsum((np.log(s) / 2 + error**2 / (2 * s)).sum(axis=0))


def fit_dropout(
    scans: TuningScans,
    samples: int = SAMPLES,
    seed: int = 0,
    lowest: float = LOWEST,
    highest: float = HIGHEST,
    steps: int = STEPS,
) -> Tuned:
    """Find the dropout rate of the least mean `objective`, of `samples` passes with a `seed`.

    The existing rate stays unless the rate that other scans choose is better on held-out scans.
    """
    rates = rates_between(lowest, highest, steps)
    before = max((layer.rate for layer in dropouts(scans.loaded.module)), default=0.0)
    rates = sorted({*rates, before} - {0.0})
    require_sampling(with_dropout(scans.loaded, lowest), samples)
    noise_of(scans.loaded.sensor)
    network = scans.network
    candidates = [with_dropout(network, rate) for rate in rates]

    def objectives_of(scan: LabelledImage) -> list[float]:
        noise = scan.of_points(aleatoric(scan.network, scan.image))
        masks, found = scan_seed(seed, scan.file.sequence, scan.file.stem), list[float]()
        for candidate in candidates:
            fitted = candidate.for_sensor(scan.network.sensor)
            sampled = sample(fitted, scan.image, samples=samples, seed=masks)
            variance = scan.of_points(sampled.variance) + noise
            probabilities = scan.of_points(sampled.probabilities)
            found.append(objective(probabilities, variance, scan.truth))
        return found

    def numbers(image: LabelledImage, of_scan: list[float]) -> tuple[list[float], int]:
        log.info("%s: %d points", image.file.name, len(image.truth))
        return of_scan, len(image.truth)

    job = Steps(scans.read, lambda images: [*map(objectives_of, images)], numbers)
    sums, counts = map(np.array, zip(*scans.run(job), strict=True))
    points = int(counts.sum())
    scans.require_points(points)
    objectives: list[float] = (sums.sum(axis=0) / points).tolist()
    if not np.isfinite(objectives).all():
        wrong = "the network's uncertainties are not finite"
        raise TrainingError(scans.source, wrong, "finite ones", "use other weights")
    best = int(np.argmin(objectives))
    changed = not before or _gains(scans.files, sums, rates.index(before))
    if changed and rates[best] in (lowest, highest):
        edge = ("--lowest", "--highest")[rates[best] == highest]
        log.warning("the best rate, %g, is the last of the range: move %s", rates[best], edge)
    report = {
        "before": before,
        "best": rates[best] if changed else before,
        "changed": changed,
        "rates": rates,
        "objectives": objectives,
        "scans": len(scans.files),
        "points": points,
    }
    return candidates[best].card if changed else network.card, report


def _gains(files: Sequence[ScanFile], sums: Double, before: int) -> bool:
    """Return whether the rate that other scans choose is better on held-out scans.

    `sums`: of the objective over the points of each scan at each rate, (scans, rates); `before`:
    index of the existing rate.
    """
    of_scan, parts, chosen = dict(zip(files, sums, strict=True)), held_out(files), 0.0
    for of_parts in parts:
        rest, part = (np.sum([of_scan[file] for file in some], axis=0) for some in of_parts)
        chosen += float(part[rest.argmin()])
    return bool(parts) and chosen < float(sums[:, before].sum())
