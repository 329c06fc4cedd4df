# SPDX-License-Identifier: MIT
"""SalsaNext written plainly, of numbers or of means and variances, layer after layer.

`SalsaNext(Numbers)` takes and gives tensors, `SalsaNext(Moments)` pairs of mean and variance, by
assumed density filtering (Gast & Roth 2018). Both take the tensors of a weights file of salsanext.
"""

import math

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

Pair = tuple[Tensor, Tensor]
"""Mean and variance."""
SLOPE = 0.01
STRIDE = 16
"""What height and width must be divisible by."""
NODES = 12
DAMPING = 0.15
TINY = 1e-30


class MomentConv2d(nn.Conv2d):
    """Var = W² ∗ v."""

    def forward(self, x: Pair) -> Pair:
        mean, variance = x
        return super().forward(mean), self._conv_forward(variance, self.weight**2, None)


class MomentBatchNorm2d(nn.BatchNorm2d):
    """Var = v γ² / (σ² + ε)."""

    def forward(self, x: Pair) -> Pair:
        mean, variance = x
        factor = self.weight**2 / (self.running_var + self.eps)
        return super().forward(mean), variance * factor[None, :, None, None]


class MomentLeakyReLU(nn.LeakyReLU):
    """Mean and variance of a leaky-rectified Gaussian, in a form in which nothing cancels."""

    def forward(self, x: Pair) -> Pair:
        (mean, variance), slope = x, self.negative_slope
        deviation = torch.sqrt(variance)
        far = (mean.abs() / (deviation + TINY)).clamp(max=12)
        beyond = 0.5 * torch.erfc(far / math.sqrt(2))
        excess = (torch.exp(-0.5 * far**2) / math.sqrt(2 * math.pi) - far * beyond).clamp(min=0)
        passed = torch.where(mean > 0, 1 - beyond, beyond)
        lost = (1 - slope) ** 2 * excess * (far + excess)
        new_mean = F.leaky_relu(mean, slope) + (1 - slope) * deviation * excess
        return new_mean, variance * (slope**2 + (1 - slope**2) * passed - lost).clamp(min=0)


class MomentAvgPool2d(nn.AvgPool2d):
    """Var = Σv / k⁴."""

    def forward(self, x: Pair) -> Pair:
        mean, variance = x
        return super().forward(mean), super().forward(variance) / self.kernel_size**2


class MomentDropout2d(nn.Dropout2d):
    """Var = m² v with the mask m that is drawn for the mean."""

    def forward(self, x: Pair) -> Pair:
        mean, variance = x
        mask = super().forward(torch.ones_like(mean[:, :, :1, :1]))
        return mean * mask, variance * mask**2


class MomentPixelShuffle(nn.PixelShuffle):
    """Moves both."""

    def forward(self, x: Pair) -> Pair:
        return super().forward(x[0]), super().forward(x[1])


class Numbers:
    """The layers of a network of numbers."""

    Conv2d, BatchNorm2d, LeakyReLU = nn.Conv2d, nn.BatchNorm2d, nn.LeakyReLU
    AvgPool2d, Dropout2d, PixelShuffle = nn.AvgPool2d, nn.Dropout2d, nn.PixelShuffle
    add = staticmethod(torch.add)

    @staticmethod
    def join(*parts: Tensor) -> Tensor:
        return torch.cat(parts, dim=1)


class Moments:
    """The layers of a network of means and variances."""

    Conv2d, BatchNorm2d, LeakyReLU = MomentConv2d, MomentBatchNorm2d, MomentLeakyReLU
    AvgPool2d, Dropout2d, PixelShuffle = MomentAvgPool2d, MomentDropout2d, MomentPixelShuffle

    @staticmethod
    def add(one: Pair, other: Pair) -> Pair:
        return one[0] + other[0], one[1] + other[1]

    @staticmethod
    def join(*parts: Pair) -> Pair:
        means, variances = zip(*parts, strict=True)
        return torch.cat(means, dim=1), torch.cat(variances, dim=1)


Layers = type[Numbers] | type[Moments]


def unit(layers: Layers, inputs: int, outputs: int, kernel: int, dilation: int = 1) -> nn.Module:
    padding = dilation * (kernel - 1) // 2
    convolution = layers.Conv2d(inputs, outputs, kernel, padding=padding, dilation=dilation)
    return nn.Sequential(convolution, layers.LeakyReLU(SLOPE), layers.BatchNorm2d(outputs))


def shortcut(layers: Layers, inputs: int, outputs: int) -> nn.Module:
    return nn.Sequential(layers.Conv2d(inputs, outputs, 1), layers.LeakyReLU(SLOPE))


class ContextBlock(nn.Module):
    def __init__(self, layers: Layers, inputs: int, outputs: int) -> None:
        super().__init__()
        self.layers = layers
        self.shortcut = shortcut(layers, inputs, outputs)
        self.local = unit(layers, outputs, outputs, 3)
        self.dilated = unit(layers, outputs, outputs, 3, dilation=2)

    def forward(self, x):
        x = self.shortcut(x)
        return self.layers.add(x, self.dilated(self.local(x)))


class DilatedStack(nn.Module):
    def __init__(self, layers: Layers, inputs: int, outputs: int) -> None:
        super().__init__()
        self.layers = layers
        self.narrow = unit(layers, inputs, outputs, 3)
        self.middle = unit(layers, outputs, outputs, 3, dilation=2)
        self.wide = unit(layers, outputs, outputs, 2, dilation=2)
        self.fuse = unit(layers, 3 * outputs, outputs, 1)

    def forward(self, x):
        narrow = self.narrow(x)
        middle = self.middle(narrow)
        return self.fuse(self.layers.join(narrow, middle, self.wide(middle)))


class ResidualBlock(nn.Module):
    def __init__(self, layers: Layers, inputs: int, outputs: int) -> None:
        super().__init__()
        self.layers = layers
        self.shortcut = shortcut(layers, inputs, outputs)
        self.stack = DilatedStack(layers, inputs, outputs)

    def forward(self, x):
        return self.layers.add(self.shortcut(x), self.stack(x))


class UpBlock(nn.Module):
    def __init__(
        self, layers: Layers, inputs: int, skip: int, outputs: int, dropout: float
    ) -> None:
        super().__init__()
        self.layers = layers
        self.shuffle = layers.PixelShuffle(2)
        self.dropouts = nn.ModuleList(layers.Dropout2d(dropout) for _ in range(3))
        self.stack = DilatedStack(layers, inputs // 4 + skip, outputs)

    def forward(self, x, skip):
        raised = self.dropouts[0](self.shuffle(x))
        joined = self.dropouts[1](self.layers.join(raised, skip))
        return self.dropouts[2](self.stack(joined))


class SalsaNext(nn.Module):
    """(B, 5, H, W) to logits (B, classes, H, W); 16 divides H and W."""

    def __init__(self, layers: Layers, classes: int, dropout: float) -> None:
        super().__init__()
        widths = (32, 64, 128, 256, 256, 256)
        self.context = nn.Sequential(*(ContextBlock(layers, n, 32) for n in (5, 32, 32)))
        for n in range(1, 6):
            self.add_module(f"block{n}", ResidualBlock(layers, widths[n - 1], widths[n]))
        rates = (0.0, dropout, dropout, dropout)
        self.downs = nn.ModuleList(
            nn.Sequential(layers.Dropout2d(rate), layers.AvgPool2d(3, stride=2, padding=1))
            for rate in rates
        )
        self.bottom = layers.Dropout2d(dropout)
        self.up1 = UpBlock(layers, 256, 256, 128, dropout)
        self.up2 = UpBlock(layers, 128, 256, 128, dropout)
        self.up3 = UpBlock(layers, 128, 128, 64, dropout)
        self.up4 = UpBlock(layers, 64, 64, 32, 0.0)
        self.logits = layers.Conv2d(32, classes, 1)

    def forward(self, x):
        one = self.block1(self.context(x))
        two = self.block2(self.downs[0](one))
        three = self.block3(self.downs[1](two))
        four = self.block4(self.downs[2](three))
        x = self.bottom(self.block5(self.downs[3](four)))
        for up, skip in ((self.up1, four), (self.up2, three), (self.up3, two), (self.up4, one)):
            x = up(x, skip)
        return self.logits(x)


def drop(network: nn.Module) -> None:
    """Let dropout act and nothing else: batch norm stays frozen."""
    network.eval()
    for module in network.modules():
        if isinstance(module, nn.Dropout2d):
            module.train()


def softmax_moments(logits: Pair) -> Pair:
    """Return mean and variance of the softmax over dimension 1 of independent Gaussians.

    A class's softmax is the logistic function of its logit minus the logarithm of the sum of the
    others' exponentials, which is taken as log-normal. Float64 keeps what is left of the sum
    without a class that is nearly all of it.
    """
    mean, variance = (part.double() for part in logits)
    mean = mean - mean.amax(1, keepdim=True)
    shares = mean.exp()

    def of_others(values: Tensor) -> Tensor:
        return (values.sum(1, keepdim=True) - values).clamp(min=0)

    others = of_others(shares) + TINY
    spread = of_others(shares**2 * variance) / others**2
    shift = 0.5 * (of_others(shares * variance) / others - spread).clamp(min=0)
    lead = mean - others.log() - shift / (1 + DAMPING * shift).sqrt()
    nodes, weights = np.polynomial.hermite_e.hermegauss(NODES)
    deviation = (variance + spread).sqrt()
    values = [torch.sigmoid(lead + node * deviation) for node in nodes]
    weights = weights / weights.sum()
    found = sum(w * value for w, value in zip(weights, values, strict=True))
    square = sum(w * (value - found) ** 2 for w, value in zip(weights, values, strict=True))
    total = found.sum(1, keepdim=True)
    probability, rest = found / total, of_others(found) / total
    deviation = (square / (1 - found).clamp(min=TINY) * rest / total).sqrt()
    # The classes sum to 1: one cannot vary more than all others together.
    most, loudest = deviation.max(1, keepdim=True)
    lacking = (2 * most - deviation.sum(1, keepdim=True)).clamp(min=0)
    likeliest = probability.scatter(1, loudest, -1.0).argmax(1, keepdim=True)
    deviation = deviation.scatter_add(1, likeliest, lacking)
    return probability.float(), torch.minimum(deviation**2, probability * rest).float()
