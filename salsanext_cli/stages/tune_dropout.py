# SPDX-License-Identifier: MIT
"""Stage `tune dropout`: the paper's grid search of the dropout rate to sample with."""

import logging
import math
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from salsanext_cli.engines.loading import with_dropout
from salsanext_cli.engines.settings import NetworkSettings
from salsanext_cli.errors import TrainingError, UsageError
from salsanext_cli.files.atomic import require_absent, require_target
from salsanext_cli.fitting.scan_fit import fitted
from salsanext_cli.geometry.normalise import noise_of
from salsanext_cli.network.dropout import dropouts
from salsanext_cli.network.weights import save_with_card
from salsanext_cli.parallel.run import Progress
from salsanext_cli.records import Float
from salsanext_cli.report.plots import rate_curve
from salsanext_cli.results.layout import find_scans
from salsanext_cli.results.selection import ScanSelection
from salsanext_cli.training.tuning.labelled_images import (
    labelled_scans,
    of_points,
    read_labelled_image,
    require_points,
)
from salsanext_cli.uncertainty.aleatoric import aleatoric
from salsanext_cli.uncertainty.monte_carlo import require_sampling, sample, scan_seed

SMALLEST_VARIANCE = 1e-4
"""Lower bound of a variance: a standard deviation of 1 % of probability.

Without it a few points that are sure and wrong would weigh more than all others.
"""
SAMPLES = 30
"""Passes per scan and rate."""
LOWEST, HIGHEST, STEPS = 0.02, 0.5, 10
"""Ends of the range of rates, and their number."""
SCANS = 20
"""Number of scans that are sampled at every rate, unless another limit is given."""

log = logging.getLogger(__name__)


def rates_between(lowest: float, highest: float, steps: int) -> list[float]:
    """Return rates at equal steps of their logarithm, both ends included."""
    for option, rate in (("--lowest", lowest), ("--highest", highest)):
        if not 0 < rate < 1:
            raise UsageError(option, f"{rate:g}", "a dropout rate above 0 and below 1")
    if not lowest < highest:
        raise UsageError("--lowest", f"{lowest:g}", f"less than --highest, {highest:g}")
    if steps < 2:
        raise UsageError("--steps", str(steps), "at least 2")
    inner = np.geomspace(lowest, highest, steps)[1:-1].tolist()
    return [lowest, *inner, highest]


def objective(probabilities: Float, variance: Float, truth: npt.NDArray[Any]) -> float:
    """Return Σ ½ log s + (y − p)² / 2s over points and classes; lower is better.

    It is the negative log-likelihood, but for a constant, of the one-hot truth y (M,) under
    Gaussians of mean p (M, C), the mean softmax over the passes, and variance s (M, C), their total
    variance; smaller ones count as `SMALLEST_VARIANCE`.
    """
    s = np.maximum(variance.astype(np.float64), SMALLEST_VARIANCE)
    error = probabilities.astype(np.float64)
    error[np.arange(len(truth)), truth] -= 1
    return math.fsum((np.log(s) / 2 + error**2 / (2 * s)).sum(axis=0))


def tune_dropout(
    dataset: Path,
    target: Path,
    *,
    network: NetworkSettings = NetworkSettings(),
    selection: ScanSelection = ScanSelection(split="valid", limit=SCANS),
    samples: int = SAMPLES,
    seed: int = 0,
    lowest: float = LOWEST,
    highest: float = HIGHEST,
    steps: int = STEPS,
    overwrite: bool = False,
    progress: Progress | None = None,
) -> dict[str, Any]:
    """Write a weights file with the dropout rate of the least objective, and draw the curve.

    The objective is Σ ½ log s + (y − p)² / 2s over points and classes, with the mean p of the
    passes and the total variance s, epistemic and aleatoric.

    `dataset`, `target`, `network`, `selection`, `overwrite`, `progress`: as for `tune_temperature`.
    The curve is `curve_of` the target; progress is called after each scan at each rate; `samples`,
    `seed`: passes per scan and rate, and the seed of their masks, as for `uncertainty`; `lowest`,
    `highest`: ends of the range; `steps`: number of rates to try, at equal steps of the logarithm.

    Returns plain data: the rate that the weights had, `before`, and the `best`; the `rates` that
    were tried and the `objectives` of each, mean over the points; the number of `scans` and of
    `points` sampled at every rate.
    """
    rates = rates_between(lowest, highest, steps)
    loaded = network.load()
    require_sampling(with_dropout(loaded, rates[0]), samples)
    noise_of(loaded.sensor)
    scans, space = labelled_scans(dataset, selection, loaded.card)
    require_target(target, overwrite)
    require_absent(curve_of(target), overwrite)
    loaded = fitted(network, loaded, find_scans(dataset))
    candidates = [with_dropout(loaded, rate) for rate in rates]
    network.announce(loaded)
    sums, points = np.zeros(len(rates)), 0
    for number, file in enumerate(scans):
        labelled = read_labelled_image(file, loaded, space)
        noise = of_points(aleatoric(loaded, labelled.image), labelled)
        points += len(labelled.truth)
        masks = scan_seed(seed, file.sequence, file.stem)
        for index, candidate in enumerate(candidates):
            sampled = sample(candidate, labelled.image, samples=samples, seed=masks)
            variance = of_points(sampled.variance, labelled) + noise
            probabilities = of_points(sampled.probabilities, labelled)
            sums[index] += objective(probabilities, variance, labelled.truth)
            if progress:
                progress(number * len(rates) + index + 1, len(scans) * len(rates))
        log.info("%s/%s: %d points", file.sequence, file.stem, len(labelled.truth))
    require_points(points, dataset, space)
    objectives: list[float] = (sums / points).tolist()
    if not np.isfinite(objectives).all():
        found = "the network's uncertainties are not finite"
        raise TrainingError(dataset, found, "finite ones", "use other weights")
    best = int(np.argmin(objectives))
    rate_curve(curve_of(target), rates, objectives, rates[best])
    if best in (0, len(rates) - 1):
        edge = ("--lowest", "--highest")[best > 0]
        log.warning("the best rate, %g, is the last of the range: move %s", rates[best], edge)
    save_with_card(network.path, target, candidates[best].card)
    before = max((layer.rate for layer in dropouts(loaded.module)), default=0.0)
    return {
        "stage": "tune dropout",
        "before": before,
        "best": rates[best],
        "rates": list(rates),
        "objectives": objectives,
        "scans": len(scans),
        "points": points,
    }


def curve_of(target: Path) -> Path:
    """Return the path of the curve that goes with a weights file."""
    return target.with_name(f"{target.stem}_dropout.png")
