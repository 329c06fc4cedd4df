# SPDX-License-Identifier: MIT
"""Train the moments: what the sensor's noise makes of the softmax should be as large as its errors.

The module trained is the deterministic one. It is given Gaussians, so that its means are what it
always learns from, and its variances can be judged beside them.
"""

from __future__ import annotations

from torch import Tensor, nn
from torch.nn import functional as F

from salsanext_cli.errors import UsageError
from salsanext_cli.geometry.noise import noise_of
from salsanext_cli.network.segmentation import SegmentationNetwork
from salsanext_cli.sensors import Sensor
from salsanext_cli.training.losses import SegmentationLoss, Whole
from salsanext_cli.training.recipe import Recipe
from salsanext_cli.uncertainty.adf import Gaussian, propagate
from salsanext_cli.uncertainty.moments import softmax_moments

FLOOR = 1e-4
"""Variance of the softmax that is there without any noise of the sensor.

Without one, a wrong pixel that is certain costs without bound. It is added, not put in the place
of what is smaller: small variances are to grow too.
"""


def require_noise(sensor: Sensor) -> None:
    """Raise `UsageError` unless the sensor has a noise, and knows it."""
    if not any(noise_of(sensor)):
        raise UsageError(
            f"sensor {sensor.name}",
            "a range_noise and an intensity_noise of 0",
            "some noise whose effect can be trained",
            "write it into a sensor's .toml, or set heteroscedastic=0",
        )


def heteroscedastic(mean: Tensor, variance: Tensor, truth: Tensor) -> Tensor:
    """Return the sum over pixels and classes of ½ log σ² + (y − p)² / (2 σ²).

    It is the negative log-likelihood, but for a constant, of the one-hot truth y under Gaussians
    (Kendall & Gal 2017, eq. 5), as in `dropout_rate.objective`.

    Parameters
    ----------
    mean, variance : (P, C) float
        Of the softmax: p, and what `FLOOR` is added to for σ².
    truth : (P,) int64
    """
    spread = variance + FLOOR
    error = F.one_hot(truth, mean.shape[1]) - mean
    return 0.5 * (spread.log() + error.square() / spread).sum()


class MomentNetwork(nn.Module):
    """Runs a network on the noise of its input too.

    Parameters
    ----------
    module : SegmentationNetwork
        Of which nothing is copied.
    """

    def __init__(self, module: SegmentationNetwork) -> None:
        super().__init__()
        self.module = module

    def forward(self, images: Tensor) -> Gaussian:
        """Map images and behind them their variances, (B, 10, H, W), to logits (B, C, H, W)."""
        return propagate(self.module, Gaussian(*images.chunk(2, dim=1)))


class HeteroscedasticLoss(nn.Module):
    """The loss of the mean logits plus a multiple of the heteroscedastic term.

    Parameters
    ----------
    of_mean : SegmentationLoss
    weight : float
        Of the term, which is a mean over the classes and the pixels that count.
    """

    def __init__(self, of_mean: SegmentationLoss, weight: float) -> None:
        super().__init__()
        self.of_mean = of_mean
        self.weight = weight

    def size(self, truth: Tensor) -> Tensor:
        """Return weight and number of the pixels of integer truth (B, H, W) that count, (2,)."""
        return self.of_mean.size(truth)

    def forward(self, logits: Gaussian, truth: Tensor, whole: Whole | None = None) -> Tensor:
        """Return the loss of logits (B, C, H, W) for integer truth (B, H, W), 0-d.

        Of a part of a `Whole`, the term is the part's share of the mean over all pixels.
        """
        pixels = whole.pixels if whole else self.size(truth)[1]
        share = self.term(logits, truth) / pixels.clamp_min(1)
        loss: Tensor = self.of_mean(logits.mean, truth, whole)
        return loss + self.weight * share

    def term(self, logits: Gaussian, truth: Tensor) -> Tensor:
        """Return the sum over the pixels that count of the term's mean over the classes, 0-d."""
        truth = truth.flatten().long()
        counts = (self.of_mean.weights[truth] > 0).nonzero()[:, 0]
        mean, variance = (
            t.movedim(1, -1).reshape(-1, t.shape[1])[counts] for t in (logits.mean, logits.variance)
        )
        of_classes = heteroscedastic(*softmax_moments(mean, variance, dim=1), truth[counts])
        return of_classes / mean.shape[1]


def with_moments(
    loss: SegmentationLoss, module: SegmentationNetwork, recipe: Recipe
) -> tuple[SegmentationLoss | HeteroscedasticLoss, nn.Module]:
    """Return the recipe's loss, and what makes of images that which the loss takes."""
    if not recipe.heteroscedastic:
        return loss, module
    return HeteroscedasticLoss(loss, recipe.heteroscedastic), MomentNetwork(module)
