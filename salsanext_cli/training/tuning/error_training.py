# SPDX-License-Identifier: MIT
"""Training of the perceptron that computes the probability that a label is wrong."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

from salsanext_cli.core.network.error_model import ErrorModel
from salsanext_cli.core.records import Float, Mask
from salsanext_cli.core.uncertainty.error_features import FEATURES

SEED = 0  # Seed of the initial weights and of the order of the points
HIDDEN = 16  # Values of each of the two hidden layers
EPOCHS = 8  # Passes over the points
BATCH = 2048  # Points per step
MIN_STEPS = 400  # Few points are passed over more often
LEARNING_RATE = 3e-3
WEIGHT_DECAY = 1e-4
SEQUENCES_OF_START = 7  # Weight of an existing model, in sequences
HEIGHT = FEATURES.index("height above the sensor")
MIN_SPREAD = 1e-3  # Least divisor of features, which may hardly differ

Layer = tuple[Float, Float]  # Weight (inputs, outputs) and bias (outputs,) of a layer


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JudgedPoints:
    """Points of one scan whose labels are known to be wrong or right."""

    features: Float  # (M, F), in the order of `FEATURES`
    wrong: Mask  # (M,)
    ambiguous_share: float = 0.0  # Share of skipped points, whose label is of several classes


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class FeatureScale:
    """Mean and spread of the features of points, by which they are standardised."""

    mean: Float  # (F,)
    spread: Float  # (F,); infinite for a feature without a weight

    @classmethod
    def from_features(cls, features: Float) -> "FeatureScale":
        """Return the scale of features (M, F).

        The height has no weight, since it depends on the mounting.
        """
        spread = np.maximum(features.std(axis=0), MIN_SPREAD)
        spread[HEIGHT] = np.inf
        return cls(mean=features.mean(axis=0), spread=spread)

    def standardised(self, features: Float) -> Float:
        """Return standardised features (M, F)."""
        return (features - self.mean) / self.spread

    def to_standardised(self, layer: Layer) -> Layer:
        """Return a first layer for standardised features, equal to one for features."""
        weight, bias = layer
        scale = np.where(np.isinf(self.spread), 0, self.spread)
        return weight * scale[:, None], bias + self.mean @ weight

    def from_standardised(self, layer: Layer) -> Layer:
        """Return a first layer for features, equal to one for standardised features."""
        weight, bias = layer
        weight = weight / self.spread[:, None]
        return weight.astype(np.float32), (bias - self.mean @ weight).astype(np.float32)


def fit_error(
    scans: Sequence[JudgedPoints], start: ErrorModel | None = None, sequences: int = 1
) -> ErrorModel:
    """Fit a model with the least cross-entropy to points.

    Parameters
    ----------
    scans : sequence of JudgedPoints
    start : ErrorModel, optional
        Model to start from. It counts as `SEQUENCES_OF_START` sequences: the truth is mixed with
        its probability.
    sequences : int
        Number of sequences that the points are of.

    Returns
    -------
    ErrorModel
    """
    features = np.concatenate([scan.features for scan in scans])
    wrong = torch.from_numpy(np.concatenate([scan.wrong for scan in scans])).float()
    if start:
        share = sequences / (sequences + SEQUENCES_OF_START)
        wrong = share * wrong + (1 - share) * torch.from_numpy(start.probability(features))
    scale = FeatureScale.from_features(features)
    with torch.random.fork_rng([]):
        torch.manual_seed(SEED)  # noqa: TID251
        linear = _initial_layers(start, scale)
        _train(linear, torch.from_numpy(scale.standardised(features)), wrong)
    first, *others = [
        (layer.weight.detach().numpy().T.copy(), layer.bias.detach().numpy()) for layer in linear
    ]
    return ErrorModel(features=FEATURES, layers=[scale.from_standardised(first), *others])


def _initial_layers(start: ErrorModel | None, scale: FeatureScale) -> list[nn.Linear]:
    """Return random layers, or those of a model, for standardised features."""
    sizes = [(len(FEATURES), HIDDEN), (HIDDEN, HIDDEN), (HIDDEN, 1)]
    if start:
        sizes = [weight.shape for weight, _ in start.layers]
    linear = [nn.Linear(inputs, outputs) for inputs, outputs in sizes]
    if start:
        first, *others = start.layers
        with torch.no_grad():
            layers = (scale.to_standardised(first), *others)
            for layer, (weight, bias) in zip(linear, layers, strict=True):
                layer.weight.copy_(torch.from_numpy(weight.T))
                layer.bias.copy_(torch.from_numpy(bias))
    return linear


def _train(linear: Sequence[nn.Linear], values: Tensor, wrong: Tensor) -> None:
    """Train layers with a ReLU between them on values (M, F); the targets are (M,), 0…1."""
    modules: list[nn.Module] = []
    for layer in linear:
        modules.append(layer)
        modules.append(nn.ReLU())
    model = nn.Sequential(*modules[:-1])
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
