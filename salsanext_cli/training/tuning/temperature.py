# SPDX-License-Identifier: MIT
"""Temperature scaling (arXiv 1706.04599): one number that calibrates a softmax."""

import logging
import math
from collections.abc import Sequence
from dataclasses import replace
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
from salsanext_cli.runs.results.paths import ScanFile
from salsanext_cli.training.cross_validation import held_out
from salsanext_cli.training.tuning.scans import LabelledImage, Tuned, TuningScans

MAX_LOGITS = 4_000_000  # 32 MB in float64: 200 000 points with 20 classes
SEED = 0  # Seed of the choice of points

Points = tuple[Tensor, Tensor]  # Their logits (M, C) float32, and train ids (M,) int64

log = logging.getLogger(__name__)


def fit_temperature(scans: TuningScans) -> Tuned:
    """Fit the temperature with the least negative log-likelihood, unless the existing is better.

    `MAX_LOGITS` limits the points of each scan to a seeded random sample. The report has the
    `temperature`, the mean negative log-likelihood in nats, `nll`, and the expected calibration
    error over 15 bins, `ece`, 0…1, `before` and `after` the fit. With several scans, the latter are
    of held-out scans, at the temperature of the others.
    """
    card = scans.network.card
    most = max(1, MAX_LOGITS // card.space.class_count // len(scans.files))

    def logits_of(images: Sequence[LabelledImage]) -> list[Float]:
        return scans.network.backend.logits([image.input for image in images])

    of_scan = scans.run(Steps(scans.read, logits_of, partial(_sample, most=most)))

    def of(files: Sequence[ScanFile]) -> Points:
        logits, truth = zip(*(of_scan[file] for file in files), strict=True)
        return torch.cat(logits), torch.cat(truth)

    logits, truth = every = of(scans.files)
    scans.require_points(len(truth))
    temperature = best_temperature(logits, truth)
    lowest, highest = TEMPERATURES
    if not lowest <= temperature <= highest:
        # It is 0 where every point is right, infinite where no class of the truth is known.
        problem = f"the best temperature for {len(truth)} points is {temperature:g}"
        expected = f"between {lowest:g} and {highest:g}"
        raise TrainingError(scans.source, problem, expected, "use more scans, or other weights")
    tempered = [
        (of(part), min(max(best_temperature(*of(rest)), lowest), highest))
        for rest, part in held_out([file for file in scans.files if len(of_scan[file][1])])
    ]
    if not tempered:
        log.warning("1 scan: not cross-validated")
    before = _scores([(every, card.temperature)])
    after = _scores(tempered or [(every, temperature)])
    # Scores of the scan of the fit do not show a gain.
    changed = after["nll"] < before["nll"] if tempered else card.temperature == 1
    report = {
        "before": {"temperature": card.temperature, **before},
        "after": {"temperature": temperature, **after},
        "folds": len(tempered),
        "changed": changed,
        "scans": len(scans.files),
        "points": len(truth),
    }
    if not changed:
        return card, report
    if card.risk and card.risk.kind != "error":
        log.log(NOTICE, "the threshold is removed: choose a new one with `salsanext tune risk`")
        card = replace(card, risk=None)
    return with_temperature(card, temperature, logits), report


def with_temperature(card: WeightsCard, temperature: float, logits: Tensor) -> WeightsCard:
    """Return a card with another temperature, and the same estimated accuracy of logits (N, C)."""
    error, accuracy = card.error, card.accuracy
    if error:
        # Its features are those at the old temperature.
        error = replace(error, temperature=error.temperature or card.temperature)
    if accuracy and len(logits):
        # The labels do not change, so neither does their estimated accuracy.
        old, new = (
            (logits.double() / t).softmax(dim=1).amax(dim=1).mean().logit(1e-6).item()
            for t in (card.temperature, temperature)
        )
        accuracy = replace(accuracy, offset=accuracy.offset + accuracy.slope * (old - new))
    return replace(card, temperature=temperature, error=error, accuracy=accuracy)


def _sample(scan: LabelledImage, logits: Float, most: int) -> Points:
    """Return the logits (M, C) and train ids (M,) of at most `most` points of a scan."""
    file, count = scan.file, len(scan.truth)
    if not np.isfinite(logits).all():
        raise WeightsError(file.path, "logits of the network are not finite")
    random = np.random.default_rng(scan_seed(SEED, file.sequence, file.stem))
    chosen = random.choice(count, most, replace=False) if count > most else slice(None)
    log.info("%s: %d points", file.name, min(count, most))
    of_points = scan.of_points(logits)[chosen].copy()
    return torch.from_numpy(of_points), torch.from_numpy(scan.truth[chosen]).long()


def _scores(tempered: Sequence[tuple[Points, float]]) -> dict[str, float]:
    """Return `nll` and `ece` of all points, each part at its temperature."""
    softmax = torch.cat([torch.softmax(logits / t, dim=1) for (logits, _), t in tempered])
    every_truth = torch.cat([truth for (_, truth), _ in tempered])
    histogram = confidence_histogram(softmax.numpy(), every_truth.numpy())
    counts = [len(truth) for (_, truth), _ in tempered]
    losses = [negative_log_likelihood(*points, t) for points, t in tempered]
    nll = float(np.average(losses, weights=counts))
    return {"nll": nll, "ece": reliability(histogram.counts).error}


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
    of_truth = exact.gather(1, truth[:, None])[:, 0]
    if (of_truth == exact.amax(dim=1)).all():
        return 0.0
    if of_truth.mean() <= exact.mean(dim=1).mean():
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
