# SPDX-License-Identifier: MIT
"""Fit of the probability that a label is wrong, and its scores on points of other scans."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
import torch
import torch.nn.functional as F
from torch import nn

from salsanext_cli.measures.calibration import reliability
from salsanext_cli.measures.histograms import error_histogram, uncertainty_histogram
from salsanext_cli.measures.kept_points import kept_points
from salsanext_cli.measures.risk_coverage import ranking_scores
from salsanext_cli.network.error_model import ErrorModel
from salsanext_cli.records import Float

HIDDEN = 32
"""Values of each of the two hidden layers."""
EPOCHS, BATCH = 12, 2048
"""Passes over the points, and points per step."""
LEAST_STEPS = 400
"""Few points are passed over more often."""
LEARNING_RATE, WEIGHT_DECAY = 3e-3, 1e-4
LEAST_SPREAD = 1e-3
"""Features that hardly differ are not blown up."""

Mask = npt.NDArray[np.bool_]


@dataclass(frozen=True, slots=True, eq=False)
class JudgedPoints:
    """Points of one scan whose labels are known to be right or wrong.

    Attributes
    ----------
    features : (M, F) float32
    confidence : (M,) float32
        Probability of the label by the network's softmax.
    wrong : (M,) bool
    """

    features: Float
    confidence: Float
    wrong: Mask


def fit_error(names: Sequence[str], scans: Sequence[JudgedPoints], seed: int = 0) -> ErrorModel:
    """Fit a model of the least cross-entropy to points of all scans, some of each class at least.

    AdamW with a one-cycle learning rate, seeded; the mean and spread of the features become part of
    the first layer.

    Parameters
    ----------
    names : sequence of str
        Names of the features.
    scans : sequence of JudgedPoints
    seed : int
        Of the first weights and of the order.
    """
    features = np.concatenate([scan.features for scan in scans])
    wrong = torch.from_numpy(np.concatenate([scan.wrong for scan in scans])).float()
    mean, spread = features.mean(axis=0), np.maximum(features.std(axis=0), LEAST_SPREAD)
    values = torch.from_numpy((features - mean) / spread)
    with torch.random.fork_rng([]):
        torch.manual_seed(seed)
        linear = [
            nn.Linear(len(names), HIDDEN),
            nn.Linear(HIDDEN, HIDDEN),
            nn.Linear(HIDDEN, 1),
        ]
        model = nn.Sequential(linear[0], nn.ReLU(), linear[1], nn.ReLU(), linear[2])
        steps_per_epoch = -(-len(values) // BATCH)
        epochs = max(EPOCHS, -(-LEAST_STEPS // steps_per_epoch))
        rate, decay = LEARNING_RATE, WEIGHT_DECAY
        optimiser = torch.optim.AdamW(model.parameters(), rate, weight_decay=decay)
        schedule = torch.optim.lr_scheduler.OneCycleLR(
            optimiser, rate, epochs=epochs, steps_per_epoch=steps_per_epoch
        )
        for _ in range(epochs):
            order = torch.randperm(len(values))
            for start in range(0, len(values), BATCH):
                chosen = order[start : start + BATCH]
                logits = model(values[chosen])[:, 0]
                loss = F.binary_cross_entropy_with_logits(logits, wrong[chosen])
                optimiser.zero_grad()
                torch.autograd.backward(loss)
                optimiser.step()
                schedule.step()
    layers = [
        (layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy()) for layer in linear
    ]
    weight, bias = layers[0]
    weight = weight / spread[:, None]
    layers[0] = weight.astype(np.float32), (bias - mean @ weight).astype(np.float32)
    return ErrorModel(tuple(names), layers)


def error_scores(error: Float, wrong: Mask) -> dict[str, float]:
    """Return the scores of a probability of error, (M,), of which some are wrong, some right.

    `auroc`, `aurc` and `ece` as `eval` has them, and `risk_80`, the share of wrong points among
    the 80 % of least error.
    """
    histogram = uncertainty_histogram(error, wrong, np.zeros(len(error), np.intp), 1)
    ranking = ranking_scores(histogram)
    counts = error_histogram(error, wrong).counts[:, 0]
    return {
        "auroc": ranking.auroc,
        "aurc": ranking.aurc,
        "ece": reliability(counts).error,
        "risk_80": kept_points("error", histogram).risk,
    }
