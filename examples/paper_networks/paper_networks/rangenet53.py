# SPDX-License-Identifier: MIT
"""RangeNet53 (Milioto et al., IROS 2019), which the SalsaNext paper compares with."""

from torch import Tensor, nn

from salsanext_cli.core.network.dropout import ChannelDropout
from salsanext_cli.core.network.segmentation import SegmentationNetwork
from salsanext_cli.core.records import CHANNELS

SLOPE, MOMENTUM = 0.1, 0.01
"""Slope of LeakyReLU below 0, and momentum of batch norm, as its authors have them."""
DEPTHS = (1, 2, 8, 8, 4)  # Residual blocks of the encoder's stages


class NormedUnit(nn.Sequential):
    """Convolution without bias → batch norm → LeakyReLU; a stride halves the width only."""

    def __init__(self, inputs: int, outputs: int, kernel: int, stride: int = 1) -> None:
        super().__init__(
            nn.Conv2d(inputs, outputs, kernel, (1, stride), padding=kernel // 2, bias=False),
            nn.BatchNorm2d(outputs, momentum=MOMENTUM),
            nn.LeakyReLU(SLOPE),
        )


class Bottleneck(nn.Module):
    """x + 3×3 unit(1×1 unit(x)), the 1×1 unit of another number of channels."""

    def __init__(self, channels: int, inner: int) -> None:
        super().__init__()
        self.narrow = NormedUnit(channels, inner, 1)
        self.wide = NormedUnit(inner, channels, 3)

    def forward(self, x: Tensor) -> Tensor:
        """Map (B, C, H, W) to the same shape."""
        return x + self.wide(self.narrow(x))


class Stage(nn.Sequential):
    """(B, C, H, W) to (B, 2C, H, W/2): a strided unit, then residual blocks."""

    def __init__(self, inputs: int, depth: int) -> None:
        outputs = 2 * inputs
        blocks = (Bottleneck(outputs, inputs) for _ in range(depth))
        super().__init__(NormedUnit(inputs, outputs, 3, stride=2), *blocks)


class UpStage(nn.Sequential):
    """(B, 2C, H, W) to (B, C, H, 2W): a transposed convolution, then a residual block."""

    def __init__(self, outputs: int) -> None:
        super().__init__(
            nn.ConvTranspose2d(2 * outputs, outputs, (1, 4), stride=(1, 2), padding=(0, 1)),
            nn.BatchNorm2d(outputs, momentum=MOMENTUM),
            nn.LeakyReLU(SLOPE),
            Bottleneck(outputs, 2 * outputs),
        )


class RangeNet53(SegmentationNetwork):
    """A Darknet53 that keeps the height of the image; 50 377 364 parameters with 20 classes."""

    stride = (1, 2 ** len(DEPTHS))

    def __init__(self, class_count: int = 20, dropout: float = 0.01, width: int = 32) -> None:
        super().__init__()
        widths = [width * 2**level for level in range(len(DEPTHS))]
        self.stem = NormedUnit(len(CHANNELS), width, 3)
        self.stages = nn.ModuleList(map(Stage, widths, DEPTHS))
        self.raises = nn.ModuleList(map(UpStage, reversed(widths)))
        self.dropout = ChannelDropout(dropout)
        self.logits = nn.Conv2d(width, class_count, 3, padding=1)

    def trunk(self, image: Tensor) -> tuple[Tensor, ...]:
        """Compute the features of stem and first stage, (B, 32, H, W) and (B, 64, H, W/2)."""
        stem: Tensor = self.stem(image)
        return stem, self.stages[0](stem)

    def decoded(self, *features: Tensor) -> Tensor:
        """Compute the features of the last stage, (B, D, H, W), from what `trunk` returns."""
        stem, first = features
        skips = [stem, self.dropout(first)]
        for stage in list(self.stages)[1:]:
            skips.append(self.dropout(stage(skips[-1])))
        upsampled = skips.pop()
        for step in self.raises:
            upsampled = step(upsampled) + skips.pop()
        return self.dropout(upsampled)
